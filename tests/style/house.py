"""Bounds on the size of code and documents. They only go down: whoever deletes lowers them, and nothing raises them."""

import ast
from collections.abc import Iterable, Iterator
from pathlib import Path

BOUNDS = {
    "lines in dynamictree": 31_753,
    "lines in lab": 6_067,
    "lines in service, jobs and worker": 13_356,
    "lines in tests": 35_640,
    "names bound to numbers in dynamictree": 548,
    "functions of dynamictree with more than 6 arguments": 4,
    "modules of dynamictree with TYPE_CHECKING": 4,
    "lines of documents": 2_986,
}
_MOST_ARGUMENTS = 6
_COMPILED = ("compiled", "compiled_fused", "compiled_reordered", "intrinsic")
"""Decorators of kernels, which take arrays one by one and may have as many arguments as they need."""


def violations(root: Path) -> Iterator[str]:
    """Every count above its bound."""
    for name, count in counts(root).items():
        if count > BOUNDS[name]:
            yield f"there are {count:,} {name}; at most {BOUNDS[name]:,} are allowed: delete as much as you add"


def counts(root: Path) -> dict[str, int]:
    """Each count that has a bound."""
    library = [path.read_text() for path in _modules(root, "dynamictree")]
    pages = [path for path in (root / "docs").rglob("*.md") if path.name != "api.md"]  # which is generated
    commands = sum(wide_functions_in(path.read_text()) for path in _modules(root, "dynamictree/commands"))
    return {
        "lines in dynamictree": _lines(root, "dynamictree"),
        "lines in lab": _lines(root, "lab"),
        "lines in service, jobs and worker": _lines(root, "service", "jobs", "worker"),
        "lines in tests": _lines(root, "tests"),
        "names bound to numbers in dynamictree": sum(numbers_in(source) for source in library),
        "functions of dynamictree with more than 6 arguments": sum(wide_functions_in(source) for source in library)
        - commands,  # whose options are arguments
        "modules of dynamictree with TYPE_CHECKING": sum("if TYPE_CHECKING" in source for source in library),
        "lines of documents": sum(len(page.read_text().splitlines()) for page in [*pages, *root.glob("[RC]*.md")]),
    }


def numbers_in(source: str) -> int:
    """Names at module level with a number in their value: thresholds, sizes, tables."""
    total = 0
    for node in ast.parse(source).body:
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        values = (part.value for part in ast.walk(node.value) if isinstance(part, ast.Constant))
        if any(type(value) in (int, float) for value in values):
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            total += len(target.elts) if isinstance(target, ast.Tuple) else 1
    return total


def wide_functions_in(source: str) -> int:
    """Functions, other than compiled kernels, with more than 6 arguments; `self` and `cls` do not count."""
    functions = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.FunctionDef)]
    kernels = {f for f in functions for mark in f.decorator_list if isinstance(mark, ast.Name) and mark.id in _COMPILED}
    return sum(_num_arguments(function) > _MOST_ARGUMENTS for function in functions if function not in kernels)


def _num_arguments(function: ast.FunctionDef) -> int:
    positional = [argument for argument in function.args.args if argument.arg not in ("self", "cls")]
    return len(positional) + len(function.args.kwonlyargs)


def _lines(root: Path, *folders: str) -> int:
    return sum(len(path.read_text().splitlines()) for folder in folders for path in _modules(root, folder))


def _modules(root: Path, folder: str) -> Iterable[Path]:
    return (root / folder).rglob("*.py")
