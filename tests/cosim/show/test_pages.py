"""Pages and videos of one episode, and the parts of a batch's report."""

import json
import re

import msgspec
import numpy as np
import pandas as pd
import pytest
from PIL import Image

from cosim.runs.road_view import road_view
from cosim.runs.surroundings_table import read_surroundings
from cosim.show import graph_drawing, svg_charts
from cosim.show.animation import data_of, html, script_of
from cosim.show.episode_view import episode_view, same_start
from cosim.show.sumo_gui import GREY, command, poses_of, replay
from cosim.show.video import write_video
from cosim.show.worst_episodes import worst_episodes
from cosim.spec.loading import load_scenario
from gri.errors import InputError


def outside(page: str) -> list[str]:
    """Addresses that a browser would ask the network for."""
    return re.findall(r"""(?:src|href)\s*=\s*["'](?!data:|#)([^"']+)|url\((?!#)|@import|fetch\(""", page)


def test_an_episode_becomes_numbers_for_the_browser(episode, road):
    data = data_of(episode, road)
    assert data["time"][:2] == [-1.0, -0.8]
    assert data["vehicles"][0]["gap"][0] == pytest.approx(15.0, abs=0.1)
    assert data["vehicles"][2]["gap"][0] is None
    assert data["vehicles"][0]["ttc"] == [None] * len(data["time"]), "an infinite time to collision is none"
    assert [(edge["from"], edge["to"], edge["type"]) for edge in data["edges"]] == [(1, 0, "follow"), (2, 1, "follow")]


def test_a_page_holds_everything_itself(episode, road):
    page = html([(episode, road)], "A & B")
    assert not outside(page)
    assert "A &amp; B" in page
    assert json.loads(script_of(episode, road)) == data_of(episode, road)
    assert "</script>0" not in page, "names of vehicles cannot end the script"


@pytest.mark.parametrize(
    "name", ["<!--<script>", "</script><script>alert(1)</script>", "]]>", "a&b\u2028", '"><img src=x>']
)
def test_what_stands_in_the_data_is_never_a_tag(tables, road, name):
    """`<!--<script>` in a vehicle's id would hide the end of the script from the browser, and remove the animation."""
    view = episode_view({**tables, "groups": tables["groups"].assign(vehicle_1=name)}, 0)
    assert name in view.ids
    text = script_of(view, road)
    assert "<" not in text
    assert json.loads(text) == data_of(view, road)
    page = html([(view, road)], name)
    assert "<" not in name or name not in page
    harmless = html([(episode_view(tables, 0), road)], "title")
    for tag in ("<script", "</script", "<!--", "<img"):
        assert page.count(tag) == harmless.count(tag)


def test_an_unknown_episode(tables):
    with pytest.raises(InputError, match="--episode: got 7, this run has the episodes 0 to 0"):
        episode_view(tables, 7)


def test_the_browser_gets_lanes_neighbours_and_the_counterpart(tables, run_folder):
    """Beside the group, 1 m ahead of it, a vehicle overtakes; the counterpart drives 2 m behind."""
    view, road = episode_view(tables, 0), road_view(tables, 0, run_folder)
    data = data_of(view, road)
    (other,) = data["neighbours"]
    assert (other["id"], other["length"]) == ("<b>beside</b>", 7.0)
    assert other["d"] == [-3.5] * len(other["s"])
    assert data["time"][other["first"]] == 0.0, "it is recorded from the take-over on"
    assert other["s"][0] == pytest.approx(data["vehicles"][2]["s"][other["first"]] + 1.0, abs=0.02)
    assert data["ghosts"][1]["s"][3] == pytest.approx(data["vehicles"][1]["s"][3] - 2.0, abs=0.02)
    assert len([lane for lane in data["lanes"] if lane["rightmost"]]) >= 5, "one of each edge, ramps included"
    assert "1 other vehicles" in data["text"]
    page = html([(view, road)], "title")
    assert "<b>beside" not in page, "names of vehicles are data"


def test_lanes_are_where_the_simulation_has_them(run_folder, tables):
    """The leftmost lane of US-101 is at d = 0; the auxiliary lane is at d = −17.7 m, from s = 187 m on."""
    lanes = road_view(tables, 0, run_folder).lanes
    assert any(np.allclose(lane.centre[:, 1], 0.0, atol=0.01) and lane.leftmost for lane in lanes)
    (auxiliary,) = [lane for lane in lanes if np.allclose(lane.centre[:, 1], -17.7, atol=0.1) and lane.rightmost]
    assert auxiliary.centre[0, 0] == pytest.approx(187, abs=1)
    assert auxiliary.width == pytest.approx(4.04)


def test_two_drives_of_one_start_are_side_by_side(episode, road, tables):
    other = {**tables, "groups": tables["groups"].assign(driver="idm")}
    assert same_start(other, episode) == 0
    page = html([(episode, road), (episode_view(other, 0), road)], "GRI beside IDM")
    assert page.count('type="application/json"') == 2
    with pytest.raises(InputError, match="--beside: got a run without the group"):
        same_start({"groups": tables["groups"].assign(vehicle_1="somebody else")}, episode)


def test_what_a_page_shows_is_also_said_in_words(episode, road):
    assert data_of(episode, road)["text"].startswith("The road from above with the vehicles </script>0 (0), ")


def test_sumo_gui_shows_everybody(tables, run_folder):
    view = episode_view(tables, 0)
    ghost = episode_view(tables, 0, counterpart=True)
    poses = poses_of(view, ghost, read_surroundings(run_folder, 0, counterpart=False))
    assert len(poses) == len(view.time)
    assert len(poses[0].names) == 6, "before the take-over there are the group and its counterpart"
    last = poses[-1]
    assert {"<b>beside</b>", view.ids[0], f"ghost of {view.ids[0]}"} <= set(last.names)
    assert last.size[last.names.index("<b>beside</b>")].tolist() == [7.0, 2.0]
    assert last.colour["<b>beside</b>"] == GREY


def test_a_video_has_a_frame_per_step(episode, road, tmp_path):
    write_video(episode, road, tmp_path / "episode.gif")
    with Image.open(tmp_path / "episode.gif") as image:
        assert getattr(image, "n_frames", 1) == len(episode.time)


def test_sumo_gui_without_a_display_says_what_to_do_instead(episode, tmp_path, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(InputError, match="cosim render"):
        replay(episode, [], tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError, match="sumo-gui is not installed"):
        replay(episode, [], tmp_path)


def test_the_command_line_of_sumo_gui_is_made_of_words(episode, tmp_path):
    (tmp_path / "scenario.json").write_bytes(msgspec.json.encode(load_scenario("us101_merge")))
    words = command(episode, tmp_path, "sumo-gui")
    assert all(isinstance(word, str) for word in words)
    assert words[words.index("--net-file") + 1].endswith("us101.net.xml")
    assert words[words.index("--step-length") + 1] == "0.2"


@pytest.fixture
def groups() -> pd.DataFrame:
    rng, rows = np.random.default_rng(0), []
    for k in range(24):
        rows.append(
            {
                "vehicle_0": "a", "vehicle_1": "b", "vehicle_2": "c",
                "run": f"r{k}", "scenario": "s", "seed": k // 2, "takeover_time": 10.0, "broken_up_by": "",
                "policy": ("gri", "idm")[k % 2], "perturbation": "braking", "intensity": float(k % 3),
                "driver": "gri", "ending": "contact" if k == 5 else "horizon", "contact": k == 5,
                "completed_without_contact": k != 5,
                "min_ttc": float(rng.uniform(1, 9)), "min_gap": float(rng.uniform(1, 9)), "mean_speed": 10.0 + k,
                "min_acceleration": -1.0, "jerk_within_3": 1.0, "edge_1_0": "follow", "edge_1_0_p": 0.9,
                "edge_0_1": "none" if k % 4 else "follow", "edge_0_1_p": 0.8,
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


def test_charts_take_the_text_colour_of_the_page_and_name_their_axes(groups):
    for text in (
        svg_charts.curves(groups, "braking", "m/s²", ("completed_without_contact", "min_gap")),
        svg_charts.distributions(groups, ["min_gap"]),
    ):
        assert text.startswith("<svg")
        assert svg_charts.INK not in text
        assert "currentColor" in text
        assert "minimum gap [m]" in text
    assert "intensity of braking [m/s²]" in svg_charts.curves(groups, "braking", "m/s²", ("completed_without_contact",))


def test_charts_have_a_text_alternative_and_lines_that_survive_grey_print(groups):
    text = svg_charts.curves(groups, "braking", "m/s²", ("contact", "min_gap")) + svg_charts.distributions(
        groups, ["min_gap", "mean_speed"]
    )
    assert text.count("<svg") == text.count('role="img"') == text.count("<title id=") == text.count("<desc id=") == 4
    named = re.findall(r'aria-labelledby="(\S+) (\S+)"', text)
    assert len({name for pair in named for name in pair}) == 8, "names are unique in the page"
    assert all(f'id="{name}"' in text for pair in named for name in pair)
    assert "Medians: gri " in text
    assert len({str(style["ls"]) for style in svg_charts.LINES}) == len({s["marker"] for s in svg_charts.LINES}) == 5
    assert [len(part) for part in svg_charts.parts([f"p{k}" for k in range(8)])] == [5, 4]


def test_graphs_are_counted(groups):
    pairs = graph_drawing.pairs_of(groups)
    assert (pairs[1, 0].type, pairs[1, 0].share, pairs[1, 0].probability) == ("follow", 1.0, pytest.approx(0.9))
    assert (pairs[0, 1].type, pairs[0, 1].share) == ("none", 0.75)
    text = graph_drawing.drawing(pairs)
    assert text.count("<path") == 1, "pairs without a relation are not drawn"
    assert "follow 100 %" in text


def test_contacts_are_the_worst_and_no_policy_fills_the_page(groups):
    found = worst_episodes(groups, 3)
    assert found["contact"].tolist() == [True, False, False]
    assert found.groupby("policy").size().max() == 2
