"""Run the notebooks of ``examples/notebooks`` and keep what their cells show: python docs/notebooks.py [NAME ...]

Cells are plain Python without magic words. What a quick run makes smaller is in the cell with the tag ``parameters``.
Not part of the library.
"""

import ast
import base64
import contextlib
import io
import json
import linecache
import re
import sys
import time
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parents[1] / "examples" / "notebooks"
ORDER = ("first_robot", "own_task", "own_search", "many_bodies")


def run(path: Path, parameters: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """A notebook with what its cells show now.

    Args:
        parameters: values that take the place of those in its cell of parameters.
    """
    notebook = json.loads(path.read_text(encoding="utf-8"))
    names: dict[str, Any] = {"__name__": "__main__"}
    for number, cell in enumerate((one for one in notebook["cells"] if one["cell_type"] == "code"), start=1):
        cell["execution_count"] = number
        cell["outputs"] = _outputs("".join(cell["source"]), names, f"<{path.stem} {number}>", number)
        if "parameters" in cell["metadata"].get("tags", ()):
            names |= parameters or {}
    return notebook


def _outputs(source: str, names: dict[str, Any], title: str, number: int) -> list[dict[str, Any]]:
    """Text that a cell prints, and what its last expression shows."""
    linecache.cache[title] = len(source), None, source.splitlines(keepends=True), title  # as in a notebook
    tree = ast.parse(source)
    end = tree.body[-1]
    last = ast.Expression(end.value) if isinstance(end, ast.Expr) else None
    tree.body = tree.body[: -1 if last else None]
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(tree, title, "exec"), names)
        value = None if last is None else eval(compile(last, title, "eval"), names)
    found: list[dict[str, Any]] = []
    if text := printed.getvalue():
        found.append({"output_type": "stream", "name": "stdout", "text": text.splitlines(keepends=True)})
    if value is not None:
        text = re.sub(r" at 0x\w+", "", repr(value))  # the same in every run
        data: dict[str, Any] = {"text/plain": text.splitlines(keepends=True)}
        if hasattr(value, "_repr_html_"):
            data["text/html"] = value._repr_html_().splitlines(keepends=True)
        if hasattr(value, "_repr_png_"):
            data["image/png"] = base64.b64encode(value._repr_png_()).decode()
        found.append({"output_type": "execute_result", "data": data, "metadata": {}, "execution_count": number})
    return found


@cache
def pages() -> dict[str, str]:
    """Place in the site -> Markdown: text, code, and what the code shows."""
    made = {}
    for name in ORDER:
        cells = json.loads((FOLDER / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]
        text = "\n\n".join(part for cell in cells for part in _parts(cell))
        text = re.sub(r"\[!\[[^\]]*\]\([^)]*\)\]", "[Open in Colab]", text)  # nothing from elsewhere
        made[f"notebooks/{name}.md"] = re.sub(r"\]\((\w+)\.ipynb\)", r"](\1.md)", text)
    return made


def _parts(cell: dict[str, Any]) -> Iterator[str]:
    source = "".join(cell["source"])
    yield f"```python\n{source}\n```" if cell["cell_type"] == "code" else source
    for one in cell.get("outputs", ()):
        data = {kind: "".join(value) for kind, value in one.get("data", {"text/plain": one.get("text", ())}).items()}
        if "text/html" in data:
            html = data["text/html"].strip().replace("\n", "&#10;")
            yield f"<div>{html}</div>"
        elif "image/png" in data:
            yield f'<img alt="" src="data:image/png;base64,{data["image/png"]}">'
        else:
            yield f"```text\n{data['text/plain']}\n```"


def main(names: list[str]) -> None:
    """Run notebooks, all or by their names, and write them."""
    for path in sorted(FOLDER.glob("*.ipynb")):
        if not names or path.stem in names:
            began = time.monotonic()
            text = json.dumps(run(path), indent=1, ensure_ascii=False) + "\n"
            path.write_text(text, encoding="utf-8")
            print(f"{path.name}: {time.monotonic() - began:.0f} s, {len(text) / 1000:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
