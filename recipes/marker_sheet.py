"""Write the printable sheet of markers: docs/pictures/marker-sheet.svg, A4, in millimetres.

python -m recipes.marker_sheet
"""

import argparse
from pathlib import Path

import numpy as np
from pyapriltags import Detector

from dynamictree.reconstruct.marker_detection import FAMILY
from dynamictree.reconstruct.markers import SHEET_EDGES_M

SHEET = Path(__file__).parents[1] / "docs" / "pictures" / "marker-sheet.svg"
WIDTH_MM, HEIGHT_MM = 210, 297
PLACES_MM = {586: (30, 15), 585: (15, 187), 584: (137, 197)}
"""Left and top of each marker's black square."""


def marker_cells(number: int) -> np.ndarray:
    """Return a marker's cells, [10, 10], true if white: the code in a black border in a white border."""
    detector = Detector(families=FAMILY)  # the detector owns the family
    family = detector.tag_families[FAMILY].contents
    code, width, total = family.codes[number], family.width_at_border, family.total_width
    cells = np.ones((total, total), np.bool_)
    border = (total - width) // 2
    cells[border : total - border, border : total - border] = False
    for bit in range(family.nbits):
        if code >> (family.nbits - 1 - bit) & 1:
            cells[family.bit_y[bit] + border, family.bit_x[bit] + border] = True
    return cells


def sheet_svg() -> str:
    """Return the SVG: every marker with white border, size and number, and a ruler to check the printed scale."""
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH_MM}mm" height="{HEIGHT_MM}mm" '
        f'viewBox="0 0 {WIDTH_MM} {HEIGHT_MM}">',
        f'<rect width="{WIDTH_MM}" height="{HEIGHT_MM}" fill="#fff"/>',
    ]
    for number, (left, top) in PLACES_MM.items():
        edge_mm = 1000 * SHEET_EDGES_M[number]
        cells = marker_cells(number)[1:-1, 1:-1]
        cell_mm = edge_mm / len(cells)
        parts.append(f'<rect x="{left}" y="{top}" width="{edge_mm:g}" height="{edge_mm:g}"/>')
        for row, column in np.argwhere(cells):
            x, y = left + column * cell_mm, top + row * cell_mm
            parts.append(f'<rect x="{x:g}" y="{y:g}" width="{cell_mm:g}" height="{cell_mm:g}" fill="#fff"/>')
        words = f"{edge_mm:g} mm, number {number}"
        parts.append(
            f'<text x="{left}" y="{top + edge_mm + 5:g}" font-size="3.5" font-family="sans-serif">{words}</text>'
        )
    words = "Print at 100 %: the line above is 100 mm long. Lay the sheet flat beside the plant, or cut markers out."
    parts += [
        '<path d="M55 173v3h100v-3" fill="none" stroke="#000" stroke-width="0.3"/>',
        f'<text x="15" y="182" font-size="3.5" font-family="sans-serif">{words}</text>',
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=SHEET)
    arguments = parser.parse_args()
    arguments.output.write_text(sheet_svg())
    print(arguments.output)


if __name__ == "__main__":
    main()
