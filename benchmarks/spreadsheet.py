"""What stands in this workbook? The cells of an .xlsx file's sheets, which are XML in a ZIP file."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path
from xml.etree import ElementTree

__all__ = ["read_sheets"]

_MAIN = "{http://schemas.openxmlformats.org/spreadsheetml/2006/main}"
_RELATION = "{http://schemas.openxmlformats.org/officeDocument/2006/relationships}id"


def read_sheets(path: Path) -> dict[str, list[list[float | str | None]]]:
    """Return the rows of each sheet by its name, cells from column A on; numbers as such, empty cells as None."""
    with zipfile.ZipFile(path) as book:
        texts: list[str] = []
        if "xl/sharedStrings.xml" in book.namelist():
            shared = ElementTree.fromstring(book.read("xl/sharedStrings.xml"))
            texts = ["".join(part.text or "" for part in item.iter(f"{_MAIN}t")) for item in shared]
        relations = ElementTree.fromstring(book.read("xl/_rels/workbook.xml.rels"))
        target = {relation.attrib["Id"]: relation.attrib["Target"] for relation in relations}
        sheets = ElementTree.fromstring(book.read("xl/workbook.xml")).iter(f"{_MAIN}sheet")
        return {
            sheet.attrib["name"]: _rows(book.read(f"xl/{target[sheet.attrib[_RELATION]]}"), texts) for sheet in sheets
        }


def _rows(document: bytes, texts: list[str]) -> list[list[float | str | None]]:
    rows = []
    for row in ElementTree.fromstring(document).iter(f"{_MAIN}row"):
        cells: list[float | str | None] = []
        for cell in row.iter(f"{_MAIN}c"):
            letters = re.match(r"[A-Z]+", cell.attrib["r"])
            column = 0
            for letter in letters.group() if letters else "A":
                column = 26 * column + ord(letter) - ord("A") + 1
            cells += [None] * (column - len(cells))
            value = cell.find(f"{_MAIN}v")
            if value is not None and value.text is not None:
                cells[column - 1] = texts[int(value.text)] if cell.attrib.get("t") == "s" else float(value.text)
        rows.append(cells)
    return rows
