"""The Python door to closed-loop runs: `run` runs a scenario and returns its `Run` (`cosim.runs.run_results`)."""

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from cosim.process.worker_process import run_in_worker
from cosim.runs.run_folder import next_folder, run_folder
from cosim.runs.user_policy import own_name, unfit
from cosim.spec.input_files import refuse_foreign_code
from cosim.spec.loading import changed, find_file, load_scenario, override, with_recording
from cosim.spec.scenario import Scenario, UserPolicy, policy_name
from cosim.spec.settings import settings_of
from gri.errors import InputError
from gri.resources import checkpoints

if TYPE_CHECKING:
    from cosim.runs.run_results import Run

Progress = Callable[[str, int, int], None]
"""Called with the stage of the run, the steps or episodes done in it, and their total."""

_BASELINES = ("sumo", "idm", "constant_velocity", "r157", "careful_human", "fsm", "rss")


def run(
    scenario: str | Path | Scenario,
    policy: object | str | Path | Mapping[str, Any] | None = None,
    *,
    seed: int | None = None,
    episodes: int | None = None,
    recording: str | Path | None = None,
    overrides: Mapping[str, Any] | None = None,
    settings: Sequence[str] = (),
    folder: str | Path | None = None,
    allow_code: bool = False,
    progress: Progress | None = None,
) -> "Run":
    """Run a scenario in closed loop and return its tables.

    SUMO runs in a process of its own. A crash or Ctrl-C therefore ends that process only, and no half-written folder
    is left behind.

    Args:
        scenario: name of a shipped scenario, path of a YAML file, or a `Scenario`.
        policy: what drives the groups instead of the scenario's policy: "sumo", "idm", "constant_velocity", or a
            reference driver ("r157", "careful_human", "fsm", "rss"); the name or path of a checkpoint; "file.py:Name"
            or "package.module:Name" of your own policy; the mapping that a YAML file would hold; or an object that has
            the attributes of `gri.Policy`.
        seed: replaces the scenario's seed.
        episodes: replaces the scenario's number of episodes.
        recording: the recording to replay, for scenarios with a recorded background.
        overrides: other top-level fields of the scenario to replace, such as `{"horizon": 4.0}`.
        settings: changes of single fields at any depth, such as `["group.max_gap=20"]`; values are written as in YAML.
        folder: where to write the run; by default a new folder in `runs/`.
        allow_code: whether to run a policy (`kind: python`) that a scenario file names outside its own folder. Code
            that `policy` names runs in any case.
        progress: called with (stage, done, total) while the run goes on; `None` shows nothing.

    Raises:
        InputError: the scenario, the policy or the folder does not fit; the message says what to change.
        RuntimeError: the simulation failed.

    Example:
        >>> import cosim
        >>> done = cosim.run("us101_car_following", policy="idm", episodes=4)
        >>> done.groups[["driver", "ending", "min_gap"]]
        >>> done.figure()
    """
    allowed = (overrides or {}).get("max_work")
    if isinstance(scenario, Scenario):
        chosen = changed(scenario, settings_of(settings)) if settings else scenario
    else:
        chosen = load_scenario(str(scenario), max_work=allowed, settings=settings)
    spec, own = _policy(policy)
    if spec is None and isinstance(chosen.policy, UserPolicy) and not isinstance(scenario, Scenario):
        file = find_file(str(scenario), "scenarios", "scenario")
        refuse_foreign_code(msgspec.to_builtins(chosen.policy), file, allow_code)
    changes = {"seed": seed, "episodes": episodes, "policy": spec, **(overrides or {})}
    chosen = override(chosen, {name: value for name, value in changes.items() if value is not None})
    if recording is not None:
        chosen = with_recording(chosen, Path(recording))
    if chosen.has_shares:
        raise InputError("share: got a scenario with a share of the traffic and no groups; call cosim.run_traffic")
    name = chosen.net if isinstance(scenario, Scenario) else Path(scenario).stem
    driver = re.sub(r"[^\w.-]+", "-", policy_name(chosen.policy) if own is None else own_name(own))
    place = Path(folder) if folder else next_folder(Path("runs"), f"{name}-{driver}-seed{chosen.seed}")
    with run_folder(place) as partial:
        run_in_worker(
            "cosim.runs.run_job:run_job",
            chosen,
            partial,
            log=partial / "sumo.log",
            tell=progress or _no_progress,
            options={"policy": own} if own is not None else {},
        )
    from cosim.runs.run_results import open_run  # with all of pandas, which a run in its worker does not wait for

    return open_run(place)


def _policy(policy: object) -> tuple[dict[str, Any] | None, object | None]:
    """A scenario's policy field, and the policy object if one was given instead of a description."""
    if policy is None:
        return None, None
    if isinstance(policy, Mapping):
        return dict(policy), None
    if isinstance(policy, str | Path):
        text = str(policy)
        if text.replace("-", "_") in _BASELINES:
            return {"kind": text.replace("-", "_")}, None
        if ":" in text and not Path(text).exists():
            return {"kind": "python", "object": text}, None
        if text in checkpoints() or Path(text).is_file():
            return {"kind": "gri", "checkpoint": text}, None
        raise InputError(
            f"policy: got {text!r}, expected one of {', '.join(_BASELINES)}, a checkpoint (a path, or one of"
            f" {', '.join(checkpoints())}), or 'file.py:Name'"
        )
    if problem := unfit(policy):
        raise InputError(f"policy: got {problem}; see gri.Policy")
    return {"kind": "python", "object": f"{type(policy).__module__}:{type(policy).__name__}"}, policy


def _no_progress(stage: str, done: int, total: int) -> None:
    pass
