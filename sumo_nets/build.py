"""Build a SUMO net from its plain XML sources: `python sumo_nets/build.py us101 [--check]`.

The output is the same byte for byte on every machine: netconvert's comment header (time stamp, absolute
paths) is cut.
"""

import argparse
import importlib.util
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
SITES = ("us101", "i80", "curved", "highway")
OPTIONS = (
    "--no-internal-links",  # no lanes inside junctions: every metre of the road belongs to one of our edges
    "--default.junctions.radius=0",  # else x jumps by 3 to 8 m where the number of lanes changes
    "--no-turnarounds",
    "--offset.disable-normalization",  # keep our coordinates: x = 0 is the entry of the study area
    "--xml-validation=never",  # SUMO's schemas would be looked up in SUMO_HOME or on the web
)


def find_netconvert() -> str | None:
    """netconvert of the eclipse-sumo wheel, else the one on PATH."""
    wheel = importlib.util.find_spec("sumo")
    folder = Path(wheel.origin).parent / "bin" if wheel and wheel.origin else None
    return (folder and shutil.which("netconvert", path=folder)) or shutil.which("netconvert")


def build(site: str) -> str:
    """The net file's text."""
    netconvert = find_netconvert()
    if netconvert is None:
        raise FileNotFoundError("netconvert not found in a wheel or on PATH; pip install eclipse-sumo")
    source = HERE / site
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.net.xml"
        inputs = (
            f"--node-files={source / 'nodes.nod.xml'}",
            f"--edge-files={source / 'edges.edg.xml'}",
            f"--connection-files={source / 'connections.con.xml'}",
            f"--type-files={source / 'types.typ.xml'}",
        )
        command = (netconvert, *inputs, *OPTIONS, f"--output-file={out}")
        run = subprocess.run(command, capture_output=True, text=True, check=False)
        if run.returncode:
            raise RuntimeError(f"netconvert failed on {source}: {run.stderr.strip()}")
        text = out.read_text(encoding="utf-8")
    return re.sub(r"<!--.*?-->\s*", "", text, count=1, flags=re.DOTALL)


def main() -> str | None:
    """Return the error to exit with, None if all is well."""
    parser = argparse.ArgumentParser(description="Build a SUMO net from its plain XML sources.")
    parser.add_argument("site", choices=SITES)
    parser.add_argument("--check", action="store_true", help="compare with the net on disk, write nothing")
    args = parser.parse_args()
    net_file = HERE / args.site / f"{args.site}.net.xml"
    try:
        text = build(args.site)
    except (FileNotFoundError, RuntimeError) as error:
        return f"error: {error}"
    if not args.check:
        net_file.write_text(text, encoding="utf-8", newline="\n")
        print(f"wrote {net_file}")
    elif not net_file.exists() or net_file.read_text(encoding="utf-8") != text:
        return f"error: {net_file} differs from its sources; run: python sumo_nets/build.py {args.site}"
    return None


if __name__ == "__main__":
    sys.exit(main())
