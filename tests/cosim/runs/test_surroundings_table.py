"""The table of surroundings: what a real run records, exact enough to verify contacts."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from cosim.runs.surroundings_table import EXACT, read_surroundings, write_surroundings
from cosim.spec.scenario import AFTERMATH
from cosim.world.surroundings import REACH
from gri.core.policy import IntelligentDriver


@pytest.fixture
def outcome(short_scenario, simulate):
    return simulate(msgspec.structs.replace(short_scenario, episodes=2, watch=11.0), IntelligentDriver(0.2))


def test_what_is_written_is_what_was_there(outcome, tmp_path):
    write_surroundings(tmp_path, outcome.episodes, outcome.left_to_sumo)
    for counterpart, episodes in ((False, outcome.episodes), (True, outcome.left_to_sumo)):
        for number, episode in enumerate(episodes):
            around, table = episode.surroundings, read_surroundings(tmp_path, number, counterpart)
            assert table is not None
            assert set(table["driver"]) == {episode.driver}
            assert table["vehicle"].tolist() == [around.ids[k] for k in around.vehicle]
            for name in EXACT:
                np.testing.assert_array_equal(table[name], around.feature(name))
            np.testing.assert_allclose(table["s"], around.feature("s"), atol=1e-4)


def test_it_holds_everybody_near_from_the_take_over_through_the_aftermath(outcome):
    for episode in (*outcome.episodes, *outcome.left_to_sumo):
        around = episode.surroundings
        wanted = episode.time[episode.time >= episode.group.time - 1e-6]
        wanted = wanted[wanted <= episode.end + AFTERMATH + 1e-6]
        np.testing.assert_array_equal(np.unique(around.time), wanted)
        for at in wanted[:: len(wanted) // 3]:
            k = int(np.flatnonzero(episode.time == at)[0])
            s = around.feature("s")[around.time == at]
            assert s.min() >= episode.feature("s")[k].min() - REACH
            assert s.max() <= episode.feature("s")[k].max() + REACH
            names = {around.ids[v] for v in around.vehicle[around.time == at]}
            assert set(np.array(episode.group.ids)[episode.valid[k]]) <= names
            assert len(names) > 30, "the road is full"


def test_runs_repeat_byte_for_byte_and_without_surroundings_nothing_is_read(outcome, tmp_path):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        write_surroundings(tmp_path / name, outcome.episodes, [])
    one, two = (tmp_path / name / "surroundings.parquet" for name in ("one", "two"))
    assert one.read_bytes() == two.read_bytes()
    assert read_surroundings(tmp_path) is None


def test_the_scenario_can_leave_it_out_and_drives_the_same(outcome, short_scenario, simulate):
    narrow = msgspec.structs.replace(short_scenario, episodes=2, watch=11.0, surroundings=False)
    for one, other in zip(outcome.episodes, simulate(narrow, IntelligentDriver(0.2)).episodes, strict=True):
        np.testing.assert_array_equal(one.state, other.state)
        assert len(other.surroundings) < len(one.surroundings)
        assert replace(one, surroundings=None).events == other.events
