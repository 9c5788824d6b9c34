"""The process of an environment's traffic: it warms up, finds groups, and forks a process for each start.

A start is a group at its take-over: the same groups at the same instants as in a run of the scenario, but each alone in
its branch. Its process waits in the first decision of the policy (`WaitingPolicy`). An episode is a fork of it, which
takes milliseconds and shares the past with all other episodes bit for bit.
"""

import math
import os
import pickle
import signal
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from multiprocessing.connection import Connection, Pipe
from multiprocessing.reduction import send_handle
from pathlib import Path

import torch

from cosim.environments.protocol import DONE, END, FAILED, LEFT_TO_SUMO, START, WRONG_INPUT, Seen, seen_of
from cosim.environments.waiting_policy import WaitingPolicy
from cosim.loop.driving import Driver, drive, start_round
from cosim.loop.intervention import Intervention, NoIntervention
from cosim.loop.perturbed_round import intervention_for
from cosim.loop.take_over_and_hand_back import PolicyControl
from cosim.loop.trunk import Trunk
from cosim.process.fork import plain_fork
from cosim.process.own_process import print_to
from cosim.spec.input_files import find_net
from cosim.spec.scenario import CarFollowing, Scenario, tag_of
from cosim.sumo import SumoError
from cosim.traffic.running_simulation import RunningSimulation, simulation
from cosim.traffic.simulation_input import SumoFiles, prepare_simulation
from cosim.traffic.warm_up import warm_up
from cosim.world.break_ups import compared
from cosim.world.episode import Episode
from cosim.world.group_search import why_not_more
from cosim.world.outcome_columns import outcome_columns
from cosim.world.snapshot import Snapshot
from gri.core.dynamics import DUBINS, POINT_MASS_1D
from gri.errors import InputError
from gri.storage.scratch import ScratchFolder

Planned = Intervention | NoIntervention


def serve(link: Connection) -> None:
    """Find the starts of the scenario that comes over the link, tell the other side of each, and end.

    The processes of the starts live on until the other side closes its connections to them.
    """
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # no zombies of ended episodes
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that drives
    torch.set_num_threads(1)  # the models are tiny: more threads are slower
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):  # the other side is gone
        try:
            scenario, sees_nearby, log = link.recv()
            print_to(log)
            _find_starts(link, scenario, sees_nearby, log)
        except InputError as error:
            link.send((WRONG_INPUT, str(error)))
        except SumoError as error:
            link.send((WRONG_INPUT, f"SUMO refused the scenario: {error}"))
        except Exception:
            link.send((FAILED, traceback.format_exc()))


def _find_starts(link: Connection, scenario: Scenario, sees_nearby: bool, log: Path) -> None:
    """Go through the rounds of a run (`cosim.loop.closed_loop.run`), with one start per group.

    Learners that see who is nearby are told of it in every step.
    """
    with ScratchFolder() as scratch:
        inputs = prepare_simulation(
            scenario, SumoFiles(find_net(scenario.net), Path(scratch, "routes.rou.xml"), log), scenario.time_limit
        )
        inputs.write()
        scenario = inputs.scenario
        with simulation(inputs) as running:
            trunk = Trunk(running, scenario, warm_up(running.world, scenario, lambda *_: _end_if_alone(link)))
            found = 0
            while found < scenario.episodes and trunk.time < inputs.end:
                _end_if_alone(link)
                history = trunk.observe_history()
                this_round = trunk.find_groups(history, limit=scenario.episodes - found)
                alone = [replace(this_round, groups=(group,)) for group in this_round.groups]
                planned = [intervention_for(scenario, history[-1], one) for one in alone]
                planned = [plan for plan in planned if plan.round.groups]
                if not planned:
                    continue
                found += len(planned)
                for plan in planned:
                    policy = partial(
                        WaitingPolicy,
                        dynamics=POINT_MASS_1D if isinstance(scenario.group, CarFollowing) else DUBINS,
                        dt=scenario.policy_period or scenario.step,
                        sees_nearby=sees_nearby,
                    )
                    _begin(link, running, history, plan, policy)
                together = tuple(plan.round.groups[0] for plan in planned)
                left = trunk.leave_to_sumo(history, replace(this_round, groups=together))
                link.send((LEFT_TO_SUMO, pickle.dumps(left)))
            link.send((DONE, why_not_more(tag_of(scenario.group), trunk.search.seen, trunk.search.failed)))


def _end_if_alone(link: Connection) -> None:
    """Raise `EOFError` if the other side has closed its end; it sends nothing after the scenario."""
    if link.poll():
        link.recv()


def _begin(
    link: Connection,
    running: RunningSimulation,
    history: Sequence[Snapshot],
    plan: Planned,
    policy: Callable[[Connection], WaitingPolicy],
) -> None:
    """Fork a start, whose `policy` waits at its link, and give the other side its connection."""
    ours, theirs = Pipe()
    if not plain_fork():
        link.close()
        theirs.close()
        _serve_start(policy(ours), running, history, plan)
    ours.close()
    width = None if plan.round.lanes is None else plan.round.lanes.target.width
    link.send((START, (plan.round.groups[0], width)))
    send_handle(link, theirs.fileno(), None)
    theirs.close()


def _serve_start(policy: WaitingPolicy, running: RunningSimulation, history: Sequence[Snapshot], plan: Planned) -> None:
    """The process of a start, and of every episode that is forked from it; it never returns."""
    try:
        with suppress(EOFError, BrokenPipeError, ConnectionResetError):  # the other side is gone
            try:
                ended = END, _drive(policy, running, history, plan)
                policy.link.send(ended)  # the link is another one now: this is a copy that was forked in `_drive`
            except (EOFError, BrokenPipeError, ConnectionResetError):
                raise
            except Exception:
                policy.link.send((FAILED, traceback.format_exc()))
    finally:
        os._exit(0)  # neither Python's nor SUMO's clean-up may run twice


def _drive(
    policy: WaitingPolicy, running: RunningSimulation, history: Sequence[Snapshot], plan: Planned
) -> tuple[Seen, dict[str, object]]:
    """Drive the episode: what is seen where it ended, and its outcome beside that of its counterpart."""
    counterparts, speeds = pickle.loads(policy.link.recv())
    start = start_round(running.frame, history, plan, Driver("environment", policy))  # returns in an episode only
    start = replace(start, intervention=plan.repeating(speeds, start.now))
    (episode,) = drive(running.world, running.frame, start)
    assert isinstance(start.control, PolicyControl)
    counterpart = next(one for one in counterparts if one.group == episode.group)
    runner = start.control.runner
    return seen_of(runner.states_for_policy(), runner.nearby_for_policy()), _facts(compared(episode, counterpart))


def _facts(episode: Episode) -> dict[str, object]:
    """The ending and the outcome; None instead of a number that is not there, so that equal facts compare equal."""
    driven = round(episode.end - episode.group.time, 3)
    facts = {"ending": episode.ending.value, "driven_s": driven, **outcome_columns(episode)}
    return {name: None if isinstance(value, float) and math.isnan(value) else value for name, value in facts.items()}
