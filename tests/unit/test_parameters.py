"""No function has more than eight parameters; kernels that need more take named tuples.

Commands are left out: typer makes an option of each of their parameters.
"""

import ast
from pathlib import Path

import pytest
from helpers.sources import ROOT, sources

MOST = 8


def parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> list[ast.arg]:
    """What a caller gives: without the object or class of a method."""
    given = function.args.posonlyargs + function.args.args
    bound = bool(given) and given[0].arg in ("self", "cls")
    return given[bound:] + function.args.kwonlyargs


def is_command(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    said = [ast.unparse(each.annotation) for each in parameters(function) if each.annotation is not None]
    return any("typer.Option" in text or "typer.Argument" in text for text in said)


def too_long(source: str) -> list[str]:
    return [
        f"{node.name} has {len(parameters(node))} parameters, line {node.lineno}"
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        and len(parameters(node)) > MOST
        and not is_command(node)
    ]


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("def f(a, b, c, d, /, e, f, g, h): ...", 0),
        ("def f(a, b, c, d, /, e, f, g, *, h, i): ...", 1),
        ("class C:\n    async def f(self, a, b, c, d, e, f, g, h): ...", 0),
        ("class C:\n    async def f(self, a, b, c, d, e, f, g, h, i): ...", 1),
        ("def f(a: Annotated[int, typer.Option()], b, c, d, e, f, g, h, i): ...", 0),
    ],
)
def test_parameters_are_counted(source: str, found: int) -> None:
    assert len(too_long(source)) == found


@pytest.mark.parametrize("path", sources(), ids=lambda path: str(path.relative_to(ROOT)))
def test_a_function_takes_eight_parameters_at_most(path: Path) -> None:
    assert not too_long(path.read_text()), "Group what belongs together into a type."
