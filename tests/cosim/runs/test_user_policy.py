"""Policies out of people's own files."""

import msgspec
import pytest
import torch

from cosim.runs.policy_loading import driver_of, policy_of
from cosim.runs.run import run
from cosim.spec.input_files import input_files, refuse_foreign_code
from cosim.spec.loading import load_scenario, override
from gri.core.trajectory import Trajectory
from gri.errors import InputError

POLICY = '''
"""Keeps a time gap."""
from dataclasses import dataclass

from gri.core.dynamics import POINT_MASS_1D, Dynamics
from gri.core.policy import PolicyState


@dataclass
class TimeGap:
    dt: float
    gap: float = 1.5
    dynamics: Dynamics = POINT_MASS_1D
    history_steps: int = 1

    def begin(self, history):
        return PolicyState(None, history.state.new_zeros(*history.state.shape[:2], 0))

    def act(self, memory, state):
        ahead = state.roll(-1, dims=1)
        wanted = 0.5 * (ahead[..., 0] - state[..., 0] - 7.0 - self.gap * state[..., 1]) + ahead[..., 1] - state[..., 1]
        return ((wanted.clamp(-3, 1.5) - state[..., 2]) / self.dt)[..., None], memory


def broken(dt):
    return 1 / 0


def nothing(dt):
    return object()
'''


@pytest.fixture
def scenario(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text(POLICY)
    monkeypatch.chdir(tmp_path)
    return load_scenario("us101_car_following")


def with_object(scenario, name: str, **settings):
    return override(scenario, {"policy": {"kind": "python", "object": name, "settings": settings}})


def test_a_class_in_a_file_becomes_a_policy(scenario):
    policy = policy_of(with_object(scenario, "mine.py:TimeGap", gap=2.0))
    assert policy is not None
    assert (policy.dt, policy.gap) == (0.2, 2.0)  # type: ignore[attr-defined]
    state = torch.tensor([[[0.0, 10.0, 0.0], [27.0, 10.0, 0.0], [54.0, 10.0, 0.0]]])
    memory = policy.begin(Trajectory.complete(state[:, :, None], 0.2))
    action, _ = policy.act(memory, state)
    assert action.shape == (1, 3, 1)
    assert action[0, 0, 0] == 0.0, "27 m = 7 m + 2 s · 10 m/s: nothing to do"


def test_an_own_policy_goes_by_its_own_name(scenario, tmp_path):
    driver = driver_of(with_object(scenario, "mine.py:TimeGap"))
    assert driver is not None
    assert driver.name == "TimeGap"
    (tmp_path / "mine.py").write_text(POLICY.replace("    dt: float\n", '    dt: float\n    name = "my time gap"\n'))
    driver = driver_of(with_object(scenario, "mine.py:TimeGap"))
    assert driver is not None
    assert driver.name == "my time gap"
    (tmp_path / "mine.py").write_text(POLICY.replace("    dt: float\n", '    dt: float\n    name = "sumo"\n'))
    with pytest.raises(InputError, match="got the name 'sumo', which means that no policy drives"):
        driver_of(with_object(scenario, "mine.py:TimeGap"))


def test_its_file_is_an_input_of_the_run(scenario, tmp_path):
    files = input_files(with_object(scenario, "mine.py:TimeGap"))
    assert files["policy"].resolve() == tmp_path / "mine.py"


def test_a_module_that_is_installed(scenario):
    policy = policy_of(with_object(scenario, "gri.core.policy:IntelligentDriver", time_headway=1.0))
    assert policy is not None
    assert policy.time_headway == 1.0  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("name", "settings", "message"),
    [
        ("nobody.py:TimeGap", {}, r"no file 'nobody.py' \(looked in"),
        ("nobody:TimeGap", {}, "no module 'nobody' is installed; for a file of your own"),
        ("nobody.at_all:TimeGap", {}, "no module 'nobody.at_all' is installed"),
        ("mine.py:Timegap", {}, "mine.py has no class or function 'Timegap'"),
        ("mine.py:TimeGap", {"gab": 2.0}, r"TimeGap\(dt=0.2, ...\) failed: TypeError: .*gab"),
        ("mine.py:broken", {}, "failed: ZeroDivisionError"),
        ("mine.py:nothing", {}, "made a object without dynamics, dt, history_steps, begin, act"),
    ],
)
def test_mistakes_say_what_is_missing(scenario, name, settings, message):
    chosen = with_object(scenario, name, **settings)
    with pytest.raises(InputError, match=message):
        policy_of(chosen)


def test_a_file_with_an_error_in_it(scenario, tmp_path):
    (tmp_path / "wrong.py").write_text("import nothing_of_that_name\n")
    with pytest.raises(InputError, match=r"wrong.py: cannot be imported: ModuleNotFoundError"):
        policy_of(with_object(scenario, "wrong.py:TimeGap"))


def test_it_must_fit_the_scenario_like_any_other(scenario):
    changed = msgspec.structs.replace(with_object(scenario, "gri.core.policy:ConstantVelocity"), step=0.2)
    assert policy_of(changed) is not None
    with pytest.raises(InputError, match=r"failed: TypeError"):
        policy_of(with_object(scenario, "gri.core.policy:ConstantVelocity", horizon=3))


@pytest.mark.parametrize(
    ("made", "message"),
    [
        ("object()", "made a object without dynamics, dt"),
        ("TimeGap(dt=float('nan'))", "whose dt is nan, expected a time"),
        ("TimeGap(dt, dynamics=None)", "whose dynamics is a NoneType, expected a gri.Dynamics"),
        ("TimeGap(dt, history_steps=0)", "whose history_steps is 0, expected a number of steps"),
        ("exit(3)", "failed: SystemExit: 3"),
    ],
)
def test_what_is_no_policy_is_refused_before_anything_runs(scenario, tmp_path, made, message):
    (tmp_path / "other.py").write_text(f"{POLICY}\n\ndef make(dt):\n    return {made}\n")
    with pytest.raises(InputError, match=message):
        policy_of(with_object(scenario, "other.py:make"))


@pytest.mark.parametrize("code", ["1 / 0", "raise SystemExit(1)", "def f(:", "import no_such_module_anywhere"])
def test_a_file_that_cannot_be_imported_is_one_line(scenario, tmp_path, code):
    (tmp_path / "worse.py").write_text(code)
    with pytest.raises(InputError, match=r"worse.py: cannot be imported: \w+") as error:
        policy_of(with_object(scenario, "worse.py:Mine"))
    assert "\n" not in str(error.value)


def test_code_outside_the_folder_of_a_file_needs_permission(scenario, tmp_path):
    inside = tmp_path / "scenarios" / "mine.yaml"
    (tmp_path / "scenarios").mkdir()
    own = msgspec.to_builtins(with_object(scenario, "mine.py:TimeGap"))
    nested = {"policies": {"a": {"kind": "python", "object": "pkg.module:Name"}}}
    refuse_foreign_code(own, tmp_path / "mine.yaml", allowed=False)
    for content in (own, nested, [{"x": [own]}]):
        with pytest.raises(InputError, match=r"names code outside .* add --allow-code"):
            refuse_foreign_code(content, inside, allowed=False)
        refuse_foreign_code(content, inside, allowed=True)


def test_a_run_of_foreign_code_is_refused_before_it_is_imported(tmp_path, monkeypatch):
    (tmp_path / "mine.py").write_text("raise SystemExit('this code must not run')")
    (tmp_path / "inner").mkdir()
    content = msgspec.to_builtins(load_scenario("us101_car_following"))
    content["policy"] = {"kind": "python", "object": "../mine.py:Mine"}
    (tmp_path / "inner" / "mine.yaml").write_bytes(msgspec.yaml.encode(content))
    with pytest.raises(InputError, match=r"mine.yaml: policy.object names code outside the folder of this file"):
        run(tmp_path / "inner" / "mine.yaml", folder=tmp_path / "out")
    assert not (tmp_path / "out").exists()
