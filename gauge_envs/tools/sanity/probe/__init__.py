"""The probe: a program without dependencies that writes settings of a training environment to a file.

Its modules run with Python 3.8 and import nothing but the standard library; `program_text` joins them into one file.
"""

import ast
from pathlib import Path

__all__ = ["program_text"]

PARTS = ("values", "mujoco_capture", "program")
"""Modules of the program, the later ones using the earlier ones; the last one has its documentation."""


def program_text() -> str:
    """Return the program as the text of one Python file."""
    imports: set[str] = set()
    bodies, documentation = [], ""
    for part in PARTS:
        source = Path(__file__).with_name(f"{part}.py").read_text(encoding="utf-8")
        lines = source.splitlines()
        documentation = str(ast.get_docstring(ast.parse(source), clean=False))
        first = 0
        for node in ast.parse(source).body:
            if isinstance(node, ast.Import | ast.ImportFrom):
                imports.add(ast.unparse(node))
            elif not (isinstance(node, ast.Expr) and not first) and "__all__" not in ast.unparse(node).split(" = ")[0]:
                break
            first = node.end_lineno or 0
        bodies.append("\n".join(lines[first:]).strip())
    own = {line for line in imports if line.startswith(("from __future__", f"from {__name__}"))}
    head = [
        "from __future__ import annotations",
        "",
        *sorted(imports - own, key=lambda line: (line.startswith("from"), line)),
    ]
    text = "\n\n\n".join(["\n".join(head), *bodies])
    return f'"""{documentation}"""\n\n{text}\n'
