"""Lanes: four or eight models computed in little more than the time of one, by the equations written for one.

A kernel that is called with lanes in the place of numbers (:mod:`pam_antagonist.model.lane_values`) gives as many
results at once. Lane k of each has the bits that the kernel gives for the numbers in lane k of its arguments.

Sums and products need nothing for that: an operator works on all lanes. Branches do, since lanes may go different ways
and a processor goes one way at a time. So the source of a kernel is rewritten before it is compiled for lanes:

==========================  ==============================================================================
in the source               in its lane form
==========================  ==============================================================================
``if c: v = a``             ``yes = c`` and ``if some(yes): v = where(yes, a, v)``
``else: v = b``             ``other = True ^ yes`` and ``if some(other): v = where(other, b, v)``
``return a`` in a branch    ``result_ = where(yes, a, result_)``; the lanes without a result go on
``a if c else b``           ``where(c, a, b)``: both are computed
``a and b``, ``not a``      ``a & b``, ``True ^ a``
==========================  ==============================================================================

A branch that no lane takes is skipped, as with numbers. What is the same in all lanes stays a number or a truth value,
and its type says so. For those, ``some`` and ``where`` do what the source does, at no cost. Options of a rig and
indices are the same for models that run side by side: the equations read them by ``shared(p[k])``, a number in either
form. Loops run over whole numbers, so all lanes take part. What a kernel calls gets lanes, and is rewritten as well.

What cannot be rewritten, such as a ``while``, is refused with its place (:class:`NoLaneForm`) or by the compiler. The
models then run one by one, with the same result (:func:`pam_antagonist.model.lanes.possible`).

To read a lane form: ``print(lane_form.written(flow.open_rate.py_func))``.
"""

from __future__ import annotations

import ast
import copy
import functools
import inspect
import itertools
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from numba.core import errors, types
from typing_extensions import override

from pam_antagonist.model.lane_values import lanes, mask, some, where


class NoLaneForm(errors.UnsupportedError):  # type: ignore[misc]
    """A function has no form for lanes; the message says which one and why."""


def lane_form(function: Any, given: Sequence[Any]) -> Any:
    """What is compiled for arguments of given types: the function, or its lane form where lanes are among them."""
    if not any(map(_has_lanes, given)):
        return function
    place, words = f"{function.__module__}.{function.__name__}", {"some": some, "where": where}
    if any(function.__globals__.get(name, word) is not word for name, word in words.items()):
        raise NoLaneForm(f"{place}: its module has another meaning for {' or '.join(words)}")
    names = {**function.__globals__, **words}
    exec(compile(written(function), f"<lane form of {place}>", "exec"), names)
    return names[function.__name__]


def _has_lanes(kind: Any) -> bool:
    parts = kind.types if isinstance(kind, types.BaseTuple) else [getattr(kind, "dtype", kind)]
    return any(part in (lanes, mask) for part in parts)


def written(function: Any) -> str:
    """The lane form of a Python function."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
    assert isinstance(tree, ast.FunctionDef)
    return "\n".join(_Writer(tree, function.__module__).function())


class _Writer(ast.NodeTransformer):
    """Writes the lane form of a function: statements as lines, expressions by changing their trees."""

    def __init__(self, tree: ast.FunctionDef, module: str) -> None:
        self.tree, self.module = tree, module
        self.known = {argument.arg for argument in tree.args.args} | {"result_"}  # names that have a value by now
        self.local = self.known | _names_set([tree])
        self.active = ""  # mask of the lanes that take the present branch; empty: all
        self.parted = 0  # returns in some lanes only, so far
        self.counter = itertools.count(1)

    def function(self) -> Iterator[str]:
        """The lines of the function."""
        for argument in self.tree.args.args:
            argument.annotation = None
        results = [node.value for node in ast.walk(self.tree) if isinstance(node, ast.Return) and node.value]
        sizes = [len(value.elts) for value in results if isinstance(value, ast.Tuple)]
        body = list(self.block(self.tree.body))
        yield f"def {self.tree.name}({ast.unparse(self.tree.args)}):"
        if self.parted:
            yield "    going_ = True"
            yield f"    result_ = {(0.0,) * max(sizes) if sizes else 0.0}"
        yield from _indented(body)
        if self.parted and results:
            yield "    return result_"

    def block(self, body: Sequence[ast.stmt]) -> Iterator[str]:
        """Statements of the active lanes, one after another."""
        if not body:
            return
        node, rest = body[0], body[1:]
        if isinstance(node, ast.If) and isinstance(node.body[-1], ast.Return) and not _is_for_none(node.test):
            # What follows a branch that returns is its ``else``.
            node, rest = ast.If(node.test, node.body, [*node.orelse, *rest]), []
        parted, write = self.parted, getattr(self, f"write_{type(node).__name__}", None)
        if write is None:
            raise self.refusal(node, f"a statement of the kind {type(node).__name__}")
        yield from write(node)
        # Where only some lanes have returned elsewhere, the others go on.
        yield from self.way(self.fresh(), "going_", rest) if rest and self.parted > parted else self.block(rest)

    def way(self, name: str, condition: str, body: Sequence[ast.stmt]) -> Iterator[str]:
        """Statements of the active lanes that meet a condition. `name`: of their mask."""
        yield f"{name} = {self.active} & ({condition})" if self.active else f"{name} = {condition}"
        yield f"if some({name}):"
        before = self.active, self.known.copy()
        self.active = name
        yield from _indented(self.block(body))
        # Names that only these lanes have set are forgotten: what others have in their place is of no meaning.
        self.active, self.known = before

    def write_Assign(self, node: ast.Assign) -> Iterator[str]:
        """``target = value``."""
        value, target, names = self.text(node.value), self.text(node.targets[0]), _names_set(node.targets)
        if self.active and (not names or names & self.known):
            yield from self.begun(names)
            value = f"where({self.active}, {value}, {target})"
        self.known |= names
        yield f"{target} = {value}"

    def write_AugAssign(self, node: ast.AugAssign) -> Iterator[str]:
        """``target += value``."""
        yield from self.write_Assign(ast.Assign([node.target], ast.BinOp(node.target, node.op, node.value)))

    def write_If(self, node: ast.If) -> Iterator[str]:
        """Each branch for the lanes that take it. A test for None stays: the compiler decides it."""
        test, yes, known = self.text(node.test), self.fresh(), self.known.copy()
        if _is_for_none(node.test):
            yield f"if {test}:"
            yield from _indented(self.block(node.body))
            known, self.known = self.known, known
            yield "else:"
            yield from _indented(self.block(node.orelse))
            self.known |= known
            return
        yield from self.begun(_names_set(node.body) & _names_set(node.orelse))
        yield from self.way(yes, test, node.body)
        if node.orelse:
            yield from self.way(self.fresh(), f"True ^ {yes}", node.orelse)

    def write_For(self, node: ast.For) -> Iterator[str]:
        """A loop over whole numbers. Lanes that return in it take no further part."""
        self.known |= _names_set([node.target])
        yield f"for {ast.unparse(node.target)} in {self.text(node.iter)}:"
        if any(isinstance(part, ast.Return) for part in ast.walk(node)):
            yield from _indented(["if not some(going_):", "    break", *self.way(self.fresh(), "going_", node.body)])
        else:
            yield from _indented(self.block(node.body))

    def write_Return(self, node: ast.Return) -> Iterator[str]:
        """A return of all lanes, or of the active ones."""
        if not self.active:
            yield f"return {self.text(node.value)}" if node.value else "return"
            return
        self.parted += 1
        if node.value:
            yield from self.write_Assign(ast.Assign([ast.Name("result_", ast.Store())], node.value))
        yield f"going_ = going_ ^ {self.active}"

    def write_Expr(self, node: ast.Expr) -> Iterator[str]:
        """A call. What it does, it does in all lanes: the compiler refuses to branch on a mask."""
        if not isinstance(node.value, ast.Constant):
            yield f"if {self.active}: {self.text(node.value)}" if self.active else self.text(node.value)

    def write_Pass(self, node: ast.Pass) -> Iterator[str]:
        """Nothing."""
        yield "pass"

    def begun(self, names: set[str]) -> Iterator[str]:
        """Start names that have no value yet: for the lanes that do not set them."""
        yield from (f"{name} = 0.0" for name in sorted(names - self.known))
        self.known |= names

    def fresh(self) -> str:
        """Name of a further mask."""
        return f"lanes_{next(self.counter)}"

    def text(self, node: ast.expr) -> str:
        """An expression in lane form."""
        return ast.unparse(self.visit(copy.deepcopy(node)))

    @override
    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id in self.local - self.known and isinstance(node.ctx, ast.Load):
            raise self.refusal(node, f"{node.id!r} is used after a branch of single lanes that sets it")
        return node

    @override
    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        operator = ast.BitAnd() if isinstance(node.op, ast.And) else ast.BitOr()
        return functools.reduce(lambda a, b: ast.BinOp(a, operator, b), map(self.visit, node.values))

    @override
    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:
        operand = self.visit(node.operand)
        is_not = isinstance(node.op, ast.Not)
        return ast.BinOp(ast.Constant(True), ast.BitXor(), operand) if is_not else ast.UnaryOp(node.op, operand)

    @override
    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        values = [self.visit(value) for value in (node.left, *node.comparators)]
        pairs: list[ast.expr] = [
            ast.Compare(a, [op], [b]) for a, op, b in zip(values, node.ops, values[1:], strict=False)
        ]
        return functools.reduce(lambda a, b: ast.BinOp(a, ast.BitAnd(), b), pairs)

    @override
    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:
        parts = [self.visit(part) for part in (node.test, node.body, node.orelse)]
        return ast.IfExp(*parts) if _is_for_none(node.test) else ast.Call(ast.Name("where"), parts, [])

    def refusal(self, node: ast.AST, what: str) -> NoLaneForm:
        """Exception for code that has no lane form."""
        return NoLaneForm(f"{self.module}.{self.tree.name}, line {getattr(node, 'lineno', 0)}: {what}")


def _is_for_none(test: ast.expr) -> bool:
    return isinstance(test, ast.Compare) and isinstance(test.ops[0], (ast.Is, ast.IsNot))


def _names_set(body: Sequence[ast.AST]) -> set[str]:
    nodes = (node for part in body for node in ast.walk(part))
    return {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}


def _indented(lines: Iterable[str]) -> Iterator[str]:
    yield from (f"    {line}" for line in list(lines) or ["pass"])
