"""`cosim check`: a line for everything that fits or does not."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from cosim.commands.cli import app
from tests.cosim.loop.test_roads import merge_on
from tests.cosim.plain_nets import MERGE, NODES, build_net

pytestmark = pytest.mark.usefixtures("forked_workers")
LINKS = ("up_0 acc_0", "up_1 acc_1", "ramp_0 acc_2", "acc_0 down_0", "acc_1 down_1")


def test_what_fits_and_what_does_not(tmp_path: Path) -> None:
    net = build_net(tmp_path, NODES | {"r": "200,75"}, MERGE, LINKS)
    path = merge_on(net, ["up", "acc", "down"], ["ramp"], "acc_2", group={"zone": [395, 690]})
    done = CliRunner().invoke(app, ["check", str(path)])
    assert done.exit_code == 0, done.output
    assert "ok      road: up → acc → down" in done.output
    assert max(map(len, done.output.splitlines()[:-1])) <= 80  # the last line has the path of a temporary folder
    told = " ".join(done.output.split())
    assert "vehicles merge to the right into acc_1" in told
    assert "warning group.zone: its end 690 m leaves 7 m to merge" in told
    path.write_text(path.read_text().replace("zone:\n  - 395\n  - 690", "zone:\n  - 5\n  - 90"))
    wrong = CliRunner().invoke(app, ["check", str(path)])
    assert wrong.exit_code == 2
    assert "error group.zone: got [5.0, 90.0], but the lane is at s = 402 to 697 m" in " ".join(wrong.output.split())


@pytest.mark.parametrize("name", ["highway", "highway_merge"])
def test_everything_fits_in_the_scenarios_of_the_plain_freeway(name: str) -> None:
    done = CliRunner().invoke(app, ["check", name])
    assert done.exit_code == 0, done.output
    assert not {"warning", "error"} & {line.partition(" ")[0] for line in done.output.splitlines()}, done.output
    assert "straight" in done.output


def test_a_net_without_lanes_in_its_nodes_is_told(tmp_path: Path) -> None:
    """At the end of the lane that ends, the node is 8 m long: a driven vehicle is on no lane there."""
    for options, told in (((), False), (("--no-internal-links",), True)):
        net = build_net(tmp_path / str(told), NODES | {"r": "200,75"}, MERGE, LINKS, options)
        path = merge_on(net, ["up", "acc", "down"], ["ramp"], "acc_2", group={"zone": [420, 600]})
        done = CliRunner().invoke(app, ["check", str(path)])
        text = " ".join(done.output.split())
        assert ("warning net: there is no lane on the" in text) == told, done.output
        assert ("from acc to down; SUMO takes a driven vehicle off the road" in text) == told
