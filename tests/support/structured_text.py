"""Runs a function block of IEC 61131-3 as blark, a parser of another make, reads it.

The standard's rules that a translation into Python would hide: variables have types and keep their
values from call to call, INT has 16 bits and takes no LREAL, arrays have bounds, AND and OR
evaluate both sides, and names are not told apart by case.
"""

import math
import operator
import re
from functools import lru_cache

import blark.parse
from blark import transform as st

_ARRAY = re.compile(r"(\w+)( : ARRAY\[(\d+)\.\.(\d+)\] OF (\w+)) := \[(.*?)\]", re.DOTALL)
_COMMENT = re.compile(r"\(\*.*?\*\)", re.DOTALL)
_INT = range(-(2**15), 2**15)


class WrongProgram(Exception):  # noqa: N818 - what a compiler or a PLC would report
    pass


class FunctionBlock:
    """An instance; calling it sets inputs, runs the body once and returns all variables."""

    def __init__(self, text):
        self.arrays = {m[1].lower(): _array(m) for m in _ARRAY.finditer(text)}
        # Values by hand, and tables that differ in comments are parsed once: its grammar is slow.
        block = _parsed(_COMMENT.sub("", _ARRAY.sub(r"\1\2", text)))
        self.body = block.body
        self.types, self.values, self.inputs = {}, {}, set()
        for section in block.declarations:
            for item in section.items:
                names = [str(variable.variable.name).lower() for variable in item.variables]
                for name in [name for name in names if name not in self.arrays]:
                    kind = str(item.init.spec.type)
                    self.types[name], self.values[name] = kind, 0 if kind == "INT" else 0.0
                    if item.init.value is not None:
                        self._assign(name, self._value(item.init.value))
                    if isinstance(section, st.InputDeclarations):
                        self.inputs.add(name)

    def __call__(self, **inputs):
        for name, value in inputs.items():
            if name.lower() not in self.inputs:
                raise WrongProgram(f"no input {name}")
            self._assign(name, value)
        self._run(self.body.statements)
        return self.values

    def _run(self, statements):
        for statement in statements:
            match statement:
                case st.AssignmentStatement():
                    (target,) = statement.variables
                    self._assign(str(target.name), self._value(statement.expression))
                case st.IfStatement():
                    self._branch(statement)
                case st.WhileStatement():
                    while self._truth(statement.expression):
                        self._run(statement.statements.statements)
                case _:
                    raise WrongProgram(f"{type(statement).__name__} is not in the subset")

    def _branch(self, statement):
        arms = [(statement.if_expression, statement.statements)]
        arms += [(arm.if_expression, arm.statements) for arm in statement.else_ifs]
        for condition, statements in arms:
            if self._truth(condition):
                self._run(statements.statements)
                return
        if statement.else_clause is not None:
            self._run(statement.else_clause.statements.statements)

    def _assign(self, name, value):
        kind = self.types.get(name.lower())
        if kind is None:
            raise WrongProgram(f"{name} is not declared")
        if kind == "INT" and (type(value) is not int or value not in _INT):
            raise WrongProgram(f"{name}, an INT, gets {value!r}")
        if isinstance(value, bool):
            raise WrongProgram(f"{name} gets {value!r}")
        self.values[name.lower()] = value if kind == "INT" else float(value)

    def _truth(self, expression):
        value = self._value(expression)
        if not isinstance(value, bool):
            raise WrongProgram(f"{value!r} is no BOOL")
        return value

    def _value(self, e):  # noqa: C901, PLR0911 - a kind of expression each
        match e:
            case st.Integer():
                return int(e.value)
            case st.Real():
                return float(e.value)
            case st.ParenthesizedExpression():
                return self._value(e.expr)
            case st.SimpleVariable():
                return self.values[str(e.name).lower()]
            case st.MultiElementVariable():
                return self._element(e)
            case st.UnaryOperation():
                value = self._value(e.expr)
                if str(e.op) == "NOT":
                    return not value
                return -value
            case st.BinaryOperation():
                return _combined(str(e.op), self._value(e.left), self._value(e.right))
            case st.FunctionCall() if str(e.name.name) == "LIMIT":
                low, x, high = (self._value(p.value) for p in e.parameters)
                return min(max(x, low), high)
            case st.FunctionCall() if str(e.name.name) in _FUNCTIONS:
                (x,) = (self._value(p.value) for p in e.parameters)
                return _FUNCTIONS[str(e.name.name)](x)
            case _:
                raise WrongProgram(f"{type(e).__name__} is not in the subset")

    def _element(self, e):
        (subscripts,) = e.elements
        (index,) = (self._value(x) for x in subscripts.subscripts)
        values = self.arrays[str(e.name.name).lower()]
        if type(index) is not int or not 0 <= index < len(values):
            raise WrongProgram(f"{e.name.name}[{index}] of {len(values)}")
        return values[index]


_FUNCTIONS = {"SQRT": math.sqrt, "ABS": abs, "EXP": math.exp, "LN": math.log}
_LOGIC = {"AND": operator.and_, "OR": operator.or_}
_SUMS = {"+": operator.add, "-": operator.sub, "*": operator.mul}
_ORDERS = {"=": operator.eq, "<>": operator.ne, "<": operator.lt, "<=": operator.le}
_ORDERS |= {">": operator.gt, ">=": operator.ge}


def _combined(op, a, b):
    logic = isinstance(a, bool), isinstance(b, bool)
    if logic != (op in _LOGIC, op in _LOGIC):
        raise WrongProgram(f"{a!r} {op} {b!r}")
    if op != "/":
        return (_LOGIC | _SUMS | _ORDERS)[op](a, b)
    if type(a) is not float or type(b) is not float:
        raise WrongProgram(f"{a!r} / {b!r}: a division of INT")
    if b == 0.0:
        return math.nan if a == 0.0 or math.isnan(a) else math.copysign(math.inf, a)
    return a / b


def _array(match):
    _, _, low, high, kind, listed = match.groups()
    values = [int(x) if kind == "INT" else float(x) for x in listed.split(",")]
    if int(low) != 0 or int(high) + 1 != len(values):
        raise WrongProgram(f"{match[1]}: {len(values)} values for {low}..{high}")
    if kind == "LREAL" and not all("." in x for x in listed.split(",")):
        raise WrongProgram(f"{match[1]}: a literal that is no LREAL")
    return values


@lru_cache(maxsize=16)
def _parsed(text):
    found = blark.parse.parse_source_code(text)
    if found.exception is not None:
        raise found.exception
    (block,) = found.transform().items
    return block
