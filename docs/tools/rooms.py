"""Draw the rooms of both packages: layers from the import contracts of pyproject.toml, words from docs/architecture.md.

`python docs/tools/rooms.py` writes docs/images/rooms.svg; tests/docs/test_architecture.py compares.
"""

import re
import tomllib
from pathlib import Path
from xml.sax.saxutils import escape

ROOT = Path(__file__).parents[2]
PICTURE = ROOT / "docs/images/rooms.svg"
PAGE = ROOT / "docs/architecture.md"
WIDTH, HEIGHT, GAP, MARGIN = 960, 46, 10, 20  # [px] of the picture, of a box, between boxes, around everything
TITLE = 34  # [px] above the first layer of a package
COLOURS = {"cosim": ("#e3f2fd", "#1565c0"), "gri": ("#e8f5e9", "#2e7d32")}  # fill and line of the boxes
TITLES = {"cosim": "cosim: the closed loop with SUMO", "gri": "gri: models, rewards and training (no SUMO)"}
BELOW = {"cosim": "↓ a room imports from lower layers and from gri", "gri": "↓ a room imports from lower layers"}
ROW = re.compile(r"^\| `(\w+)/?(?:\.py)?` \| ([^|]+) \| ([^|]+) \|$", re.MULTILINE)


def layers() -> dict[str, list[list[str]]]:
    """The layers of rooms of each package, the top one first, as the import contracts have them."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    return {
        contract["containers"][0]: [[room.strip() for room in re.split(r"[|:]", layer)] for layer in contract["layers"]]
        for contract in contracts
        if contract["type"] == "layers"
    }


def rooms_of_page(text: str) -> dict[str, dict[str, tuple[str, str]]]:
    """What the page's tables say of the rooms of each package: what one does there, and where to begin."""
    parts = {title.split("`")[1]: part for title, part in re.findall(r"^### (.*?)\n(.*?)(?=^##|\Z)", text, re.M | re.S)}
    return {package: {row[0]: (row[1], row[2]) for row in ROW.findall(part)} for package, part in parts.items()}


def picture(drawn: dict[str, list[list[str]]], words: dict[str, dict[str, tuple[str, str]]]) -> str:
    """The SVG: a row of boxes per layer; every room may import from the layers below its own."""
    y, parts = MARGIN, []
    for package in sorted(drawn, key=list(TITLES).index):
        fill, line = COLOURS[package]
        parts.append(_text(MARGIN, y + 20, TITLES[package], 'font-size="18" font-weight="bold"'))
        parts.append(_text(WIDTH - MARGIN, y + 20, BELOW[package], 'font-size="12" text-anchor="end" fill="#37474f"'))
        y += TITLE
        for layer in drawn[package]:
            width = (WIDTH - 2 * MARGIN - GAP * (len(layer) - 1)) / len(layer)
            for k, room in enumerate(layer):
                x = MARGIN + k * (width + GAP)
                box = f'x="{x:g}" y="{y}" width="{width:g}" height="{HEIGHT}" rx="6"'
                parts.append(f'<rect {box} fill="{fill}" stroke="{line}"/>')
                parts.append(_text(x + 10, y + 19, room, 'font-size="14" font-weight="bold"'))
                parts.append(
                    _text(x + 10, y + 36, words[package][room][0].replace("`", ""), 'font-size="11.5" fill="#37474f"')
                )
            y += HEIGHT + GAP
        y += MARGIN
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {y}" role="img" '
        'font-family="Helvetica, Arial, sans-serif" fill="#102027">'
    )
    title = "<title>Rooms of cosim and gri, layer by layer; imports point downwards only</title>"
    return "\n".join([head, title, f'<rect width="{WIDTH}" height="{y}" fill="#fff"/>', *parts, "</svg>"]) + "\n"


def _text(x: float, y: float, text: str, style: str) -> str:
    return f'<text x="{x:g}" y="{y:g}" {style}>{escape(text)}</text>'


def draw() -> str:
    """The picture as it is now."""
    drawn, words = layers(), rooms_of_page(PAGE.read_text())
    missing = [
        f"{package}/{room}"
        for package, rows in drawn.items()
        for row in rows
        for room in row
        if room not in words[package]
    ]
    if missing:
        raise ValueError(f"{PAGE.name}: no row for {', '.join(missing)}; add one to the table of its package")
    return picture(drawn, words)


if __name__ == "__main__":
    PICTURE.write_text(draw())
    print(f"wrote {PICTURE.relative_to(ROOT)}")
