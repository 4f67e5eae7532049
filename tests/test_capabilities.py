"""Code outside of the model asks an estimator for a capability, never for its class."""

import ast
from functools import cache
from pathlib import Path

import pytest

SERVICE = Path(__file__).parents[1] / "service/valvemap"
MODEL = SERVICE / "model"


def is_estimator(node):
    methods = {part.name for part in node.body if isinstance(part, ast.FunctionDef)}
    bases = {ast.unparse(base).split("[")[0] for base in node.bases}
    return {"initial_state", "update", "predict"} <= methods and "Protocol" not in bases


@cache
def concrete_estimators():
    return {
        node.name
        for file in MODEL.rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text()))
        if isinstance(node, ast.ClassDef) and is_estimator(node)
    }


def names_in(node):
    return {part.id for part in ast.walk(node) if isinstance(part, ast.Name)} | {
        part.attr for part in ast.walk(node) if isinstance(part, ast.Attribute)
    }


def asks(tree, classes):
    """Lines that ask for one of the classes: isinstance, a class pattern, type(x) is."""
    for node in ast.walk(tree):
        match node:
            case ast.Call(func=ast.Name(id="isinstance" | "issubclass"), args=[_, kinds]):
                asked = names_in(kinds)
            case ast.MatchClass(cls=kind):
                asked = names_in(kind)
            case ast.Compare(left=ast.Call(func=ast.Name(id="type"))):
                asked = names_in(node)
            case _:
                continue
        if asked & classes:
            yield node.lineno


def test_the_search_finds_the_estimators_and_every_form_of_the_question():
    assert {"RecursiveLeastSquares", "FlowMap", "RbfNetwork"} <= concrete_estimators()
    forms = [
        "isinstance(x, FlowMap)",
        "isinstance(x, int | model.FlowMap)",
        "isinstance(x, (str, FlowMap))",
        "match x:\n    case str() | FlowMap(): pass",
        "type(x) is FlowMap",
    ]
    for form in forms:
        assert list(asks(ast.parse(form), {"FlowMap"})), form
    assert not list(asks(ast.parse("FlowMap(); isinstance(x, Other)"), {"FlowMap"}))


@pytest.mark.parametrize("room", sorted(p.name for p in SERVICE.iterdir() if p != MODEL))
def test_no_room_outside_of_the_model_asks_for_a_class_of_estimators(room):
    place = SERVICE / room
    files = [place] if place.suffix == ".py" else sorted(place.rglob("*.py"))
    asked = [
        f"{file.relative_to(SERVICE)}:{line}"
        for file in files
        if file.is_file()
        for line in asks(ast.parse(file.read_text()), concrete_estimators())
    ]
    assert not asked
