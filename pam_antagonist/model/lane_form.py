"""The lane form of compiled functions: the same equations for several numbers at once, written from their source.

The equations are written once, for numbers. Their form for lanes (:mod:`pam_antagonist.model.lane_values`) differs only
in the branches, since different lanes may take different ones. This module generates it from the functions' source:

* ``if c: v = a`` becomes ``if some(c): v = where(c, a, v)``: a branch that no lane takes is skipped, as with numbers;
* a ``return`` within such a branch sets the result of the lanes that take the branch; the others go on;
* an entry of an array, ``a[k]``, becomes ``item(a, k)``: arrays of lanes have a further dimension.

A condition that is the same in all lanes stays an ``if``. Code without a lane form raises :class:`NoLaneForm`: the
functions for numbers are used instead, with the same result.

To read the generated module: ``python -m pam_antagonist.model.lane_drive``.
"""

from __future__ import annotations

import ast
import copy
import inspect
import itertools
import textwrap
from collections.abc import Iterator, Sequence
from typing import Any

from typing_extensions import override

from pam_antagonist.model import parameters as par

_SHARED_ARGUMENTS = ("i", "muscle", "valve", "dt", "place", "law", "direction", "acceleration")
"""Arguments that are the same in all lanes, whatever function has them."""
_STRUCTURAL_ARGUMENTS = ("law",)
"""Arguments that are indices of parameters that are the same in all lanes."""
_BUILT_IN = ("abs", "min", "max", "range", "int", "float")
_HEADER = '''"""The equations for lanes; written by pam_antagonist.model.lane_form, which explains it."""

import math

import numpy as np

from pam_antagonist._jit import in_place, inlined
from pam_antagonist.model.lane_values import both, either, item, no, put, shared, some, where
'''


class NoLaneForm(Exception):
    """A function has no form for lanes; the message says which one and why."""


def lane_module(roots: Sequence[Any]) -> str:
    """Source of a module with the lane form of some compiled functions, and of all functions that they call."""
    module = _Module()
    for root in roots:
        module.names[id(root)] = root.py_func.__name__
    for root in roots:
        module.add(root)
    constants = "\n".join(f"{name} = {text}" for name, text in module.constants.items())
    imports = "\n".join(sorted(module.imports))
    return f"{_HEADER}{imports}\n\n{constants}\n\n\n" + "\n\n\n".join(module.functions) + "\n"


class _Module:
    """Collects the text of the generated module."""

    def __init__(self) -> None:
        self.names: dict[int, str] = {}
        self.done: set[int] = set()
        self.constants: dict[str, str] = {}
        self.imports: dict[str, None] = {}
        self.functions: list[str] = []

    def add(self, kernel: Any) -> str:
        """Name of a function's lane form, which is generated at the first call."""
        function = kernel.py_func
        name = self.names.setdefault(id(kernel), f"{function.__module__.split('.')[-1]}__{function.__name__}")
        if id(kernel) not in self.done:
            self.done.add(id(kernel))
            way = "inlined" if kernel.targetoptions.get("forceinline") else "in_place"
            self.functions.append(f"@{way}\n{ast.unparse(_Function(self, function, name).written())}")
        return name

    def named(self, name: str, function: Any) -> str:
        """Name in the generated module for a global name of a function."""
        if name not in function.__globals__:
            if name in _BUILT_IN:
                return name
            raise NoLaneForm(f"{function.__name__}: {name!r} is no name of its module")
        value = function.__globals__[name]
        if name in ("math", "np"):
            return name
        if hasattr(value, "py_func") and hasattr(value, "targetoptions"):
            return self.add(value)
        where = function.__module__.split(".")[-1]
        if isinstance(value, (int, float)) or type(value).__module__ == "numpy":
            of_numpy = type(value).__module__ == "numpy"
            text = f"float({str(value)!r})" if isinstance(value, float) else repr(value)
            self.constants[f"{where}__{name}"] = f"np.{type(value).__name__}({value})" if of_numpy else text
            return f"{where}__{name}"
        if type(value).__module__.startswith("numba"):
            alias = f"{where}__{name}"
            self.imports[f"from {function.__module__} import {name} as {alias}"] = None
            return alias
        raise NoLaneForm(f"{function.__name__}: {name!r} is neither compiled nor a number")


class _Function:
    """Generates the lane form of one function, statement by statement."""

    def __init__(self, module: _Module, function: Any, name: str) -> None:
        self.module, self.function, self.name = module, function, name
        tree = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
        assert isinstance(tree, ast.FunctionDef)
        self.tree = tree
        self.arguments = [argument.arg for argument in tree.args.args]
        self.locals = {n.id for n in ast.walk(tree) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
        self.locals |= set(self.arguments)
        # Names that have a value in every lane by now.
        self.known: set[str] = set(self.arguments)
        # Names that have the same value in all lanes.
        self.shared = set(_SHARED_ARGUMENTS) & set(self.arguments)
        # Names of indices of parameters that are the same in all lanes.
        self.structural = set(_STRUCTURAL_ARGUMENTS) & set(self.arguments)
        self.counter = itertools.count(1)
        # Of each loop with a return, from the outermost: the mask of the lanes that have no result yet.
        self.going: list[str] = []

    def written(self) -> ast.FunctionDef:
        """The lane form of the function."""
        body = self.tree.body
        if isinstance(body[0], ast.Expr) and isinstance(body[0].value, ast.Constant):
            body = body[1:]
        body = _returns_last(body)
        sizes = {len(r.value.elts) for r in _returns(body) if isinstance(r.value, ast.Tuple)}
        valued = any(r.value is not None for r in _returns(body))
        self.results = [f"result_{k}" for k in range(max(sizes, default=int(valued)))]
        self.predicated = False
        inner = self.block(body, None)
        if self.predicated:
            start = [_assign(name, ast.Constant(0.0)) for name in self.results]
            results: list[ast.expr] = [_name(name) for name in self.results]
            result = ast.Tuple(results, ast.Load()) if len(results) > 1 else results[0]
            inner = [*start, *inner, ast.Return(result)]
        arguments = copy.deepcopy(self.tree.args)
        for argument in arguments.args:
            argument.annotation = None
        # A copy of the node has whatever fields this Python's version gives it.
        out = copy.copy(self.tree)
        out.name, out.args, out.body = self.name, arguments, inner
        out.decorator_list, out.returns = [], None
        return ast.fix_missing_locations(out)

    # Statements.

    def block(self, body: Sequence[ast.stmt], active: str | None) -> list[ast.stmt]:
        """Lane form of statements, for the lanes in the mask ``active`` (None: all lanes)."""
        out: list[ast.stmt] = []
        for k, statement in enumerate(body):
            out += self.statement(statement, active)
            if isinstance(statement, ast.For) and any(_returns([statement])):
                going = self.fresh("mask")
                out += [_assign(going, _name(self.going.pop())), *self.way(going, body[k + 1 :])]
                break
        return out

    def statement(self, node: ast.stmt, active: str | None) -> Iterator[ast.stmt]:
        """Lane form of a statement."""
        if isinstance(node, ast.Assign) and len(node.targets) == 1:
            yield from self.assignment(node.targets[0], node.value, active)
        elif isinstance(node, ast.AugAssign):
            changed = ast.BinOp(_loaded(node.target), node.op, node.value)
            yield from self.assignment(node.target, changed, active)
        elif isinstance(node, ast.If):
            yield from self.branch(node, active)
        elif isinstance(node, ast.For):
            yield from self.loop(node, active)
        elif isinstance(node, ast.Return):
            yield from self.returned(node, active)
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            if active is not None:
                raise self.refusal(node, "a call whose lanes go different ways")
            value, before = self.expression(node.value)
            yield from (*before, ast.Expr(value))
        elif not isinstance(node, ast.Pass):
            raise self.refusal(node, f"a statement of the kind {type(node).__name__}")

    def assignment(self, target: ast.expr, value: ast.expr, active: str | None) -> Iterator[ast.stmt]:
        """``target = value`` in the active lanes."""
        if isinstance(target, ast.Tuple):
            parts = [self.fresh("part") for _ in target.elts]
            given, before = self.expression(value)
            yield from before
            yield ast.Assign([ast.Tuple([_name(part, True) for part in parts], ast.Store())], given)
            pairs = list(zip(target.elts, parts, strict=True))
            if isinstance(value, ast.Tuple):
                self.follow_all(target, value)
            for to, part in pairs:
                yield from self.set(to, _name(part), active)
            return
        if isinstance(target, ast.Name):
            self.follow(target.id, value)
        given, before = self.expression(value)
        yield from before
        yield from self.set(target, given, active)

    def set(self, target: ast.expr, value: ast.expr, active: str | None) -> Iterator[ast.stmt]:
        """Set a name or an entry of an array to a value in lane form."""
        if isinstance(target, ast.Name):
            if active is not None:
                self.shared.discard(target.id)
            if active is not None and target.id in self.known:
                value = _call("where", _name(active), value, _name(target.id))
            self.known.add(target.id)
            yield _assign(target.id, value)
            return
        if not isinstance(target, ast.Subscript):
            raise self.refusal(target, f"an assignment to {ast.unparse(target)}")
        array, before = self.expression(target.value)
        index, more = self.expression(target.slice)
        if active is not None:
            value = _call("where", _name(active), value, _call("item", array, index))
        yield from (*before, *more, ast.Expr(_call("put", array, index, value)))

    def branch(self, node: ast.If, active: str | None) -> Iterator[ast.stmt]:
        """An ``if``: it stays one if the condition is the same in all lanes; otherwise each branch gets a mask."""
        condition, before = self.expression(node.test)
        yield from before
        if self.is_shared(node.test):
            # Both branches start with the same names. Names set in either are known after them: all lanes went the
            # same way, and as in the source, nothing uses a name that was not set on it.
            known, shared = set(self.known), set(self.shared)
            body = self.block(node.body, active)
            known_then, shared_then = self.known, self.shared
            self.known, self.shared = known, shared
            other = self.block(node.orelse, active)
            self.known, self.shared = self.known | known_then, self.shared & shared_then
            yield ast.If(condition, body or [ast.Pass()], other)
            return
        either_way = _set_names(node.body) & _set_names(node.orelse)
        for name in sorted(either_way - self.known):
            yield _assign(name, ast.Constant(0.0))
            self.known.add(name)
        yes = self.fresh("mask")
        yield _assign(yes, condition if active is None else _call("both", _name(active), condition))
        yield from self.way(yes, node.body)
        if node.orelse:
            other_way = self.fresh("mask")
            negated: ast.expr = _call("no", _name(yes))
            yield _assign(other_way, negated if active is None else _call("both", _name(active), negated))
            yield from self.way(other_way, node.orelse)

    def way(self, mask: str, body: Sequence[ast.stmt]) -> Iterator[ast.stmt]:
        """One branch of an ``if``, skipped where no lane takes it."""
        known = set(self.known)
        inner = self.block(body, mask)
        self.known = known
        yield ast.If(_call("some", _name(mask)), inner or [ast.Pass()], [])
        if self.going and any(_returns(body)):
            # Within a loop, lanes that have their result take no further part.
            going = self.going[-1]
            yield _assign(going, _call("both", _name(going), _call("no", _name(mask))))
            yield ast.If(ast.UnaryOp(ast.Not(), _call("some", _name(going))), [ast.Break()], [])

    def loop(self, node: ast.For, active: str | None) -> Iterator[ast.stmt]:
        """A loop over integers that are the same in all lanes."""
        if not isinstance(node.target, ast.Name) or node.orelse or not self.is_shared(node.iter):
            raise self.refusal(node, "a loop that is not over whole numbers that all lanes share")
        self.shared.add(node.target.id)
        over, before = self.expression(node.iter)
        yield from before
        self.known.add(node.target.id)
        # Names set in the loop may differ between lanes from the second pass on.
        self.shared -= _set_names(node.body)
        if any(_returns(node.body)):
            active_before, active = active, self.fresh("going")
            yield _assign(active, ast.Constant(True) if active_before is None else _name(active_before))
            self.going.append(active)
        yield ast.For(_name(node.target.id, True), over, self.block(node.body, active), [])

    def returned(self, node: ast.Return, active: str | None) -> Iterator[ast.stmt]:
        """A ``return``, of the whole function or of the active lanes."""
        if node.value is None:
            if active is not None:
                raise self.refusal(node, "an end in some lanes")
            yield ast.Return(None)
            return
        value, before = self.expression(node.value)
        yield from before
        if active is None and not self.predicated:
            yield ast.Return(value)
            return
        self.predicated = True
        parts: list[ast.expr]
        if isinstance(value, ast.Tuple):
            parts = value.elts
        elif len(self.results) == 1:
            parts = [value]
        else:
            names = [self.fresh("part") for _ in self.results]
            yield ast.Assign([ast.Tuple([_name(name, True) for name in names], ast.Store())], value)
            parts = [_name(name) for name in names]
        for name, part in zip(self.results, parts, strict=True):
            yield _assign(name, part if active is None else _call("where", _name(active), part, _name(name)))

    # Expressions.

    def expression(self, node: ast.expr) -> tuple[ast.expr, list[ast.stmt]]:
        """Lane form of an expression, and the statements that must precede it."""
        before: list[ast.stmt] = []
        writer = _Expression(self, before)
        return writer.visit(copy.deepcopy(node)), before

    def fresh(self, what: str) -> str:
        """A new name that no other variable has."""
        return f"{what}_{next(self.counter)}_"

    def follow(self, name: str, value: ast.expr) -> None:
        """Note whether a name that is set is an index of structure, and whether it is the same in all lanes."""
        (self.structural.add if self.is_structural(value) else self.structural.discard)(name)
        (self.shared.add if self.is_shared(value) else self.shared.discard)(name)

    def follow_all(self, target: ast.Tuple, value: ast.Tuple) -> None:
        """:meth:`follow` for several names."""
        for to, part in zip(target.elts, value.elts, strict=True):
            if isinstance(to, ast.Name):
                self.follow(to.id, part)

    def is_structural(self, index: ast.expr) -> bool:
        """Whether an index is that of a parameter that has the same value in all lanes."""
        for node in _outside_of_entries(index):
            if isinstance(node, ast.Name):
                value = self.function.__globals__.get(node.id)
                if node.id in self.structural and node.id in self.locals:
                    return True
                if node.id not in self.locals and isinstance(value, int) and _holds_structure(value):
                    return True
        return False

    def is_shared(self, node: ast.expr) -> bool:
        """Whether a value is the same in all lanes."""
        if isinstance(node, ast.Constant):
            return True
        if isinstance(node, ast.Name):
            return node.id in self.shared if node.id in self.locals else True
        if isinstance(node, ast.Attribute):
            return node.attr == "shape" or (isinstance(node.value, ast.Name) and node.value.id in ("math", "np"))
        if isinstance(node, ast.Subscript):
            if isinstance(node.value, ast.Attribute) and node.value.attr == "shape":
                return True
            return isinstance(node.value, ast.Name) and node.value.id == "p" and self.is_structural(node.slice)
        if isinstance(node, ast.Compare) and all(isinstance(op, (ast.Is, ast.IsNot)) for op in node.ops):
            return True
        if isinstance(node, ast.Call):
            name = node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
            return name in (*_BUILT_IN, "uint64") and all(self.is_shared(part) for part in node.args)
        if isinstance(node, (ast.BinOp, ast.UnaryOp, ast.BoolOp, ast.Compare, ast.IfExp)):
            return all(self.is_shared(part) for part in ast.iter_child_nodes(node) if isinstance(part, ast.expr))
        return False

    def refusal(self, node: ast.AST, what: str) -> NoLaneForm:
        """Exception for code that has no form for lanes."""
        place = f"{self.function.__module__}.{self.function.__name__}, line {getattr(node, 'lineno', 0)}"
        return NoLaneForm(f"{place}: {what}")


class _Expression(ast.NodeTransformer):
    """Rewrites an expression of one function; ``before`` collects the statements that must precede it."""

    def __init__(self, function: _Function, before: list[ast.stmt]) -> None:
        self.of, self.before = function, before

    @override
    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id in self.of.locals:
            if node.id not in self.of.known:
                # A later branch may have overwritten it in the lanes of an earlier one.
                raise self.of.refusal(node, f"{node.id!r} is used after branches of single lanes that set it")
            return node
        return _name(self.of.module.named(node.id, self.of.function))

    @override
    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        if isinstance(node.value, ast.Name) and node.value.id in ("math", "np"):
            return node
        return ast.Attribute(self.visit(node.value), node.attr, node.ctx)

    @override
    def visit_Subscript(self, node: ast.Subscript) -> ast.expr:
        if isinstance(node.slice, ast.Slice) or (isinstance(node.value, ast.Attribute) and node.value.attr == "shape"):
            return ast.Subscript(self.visit(node.value), self.visit(node.slice), node.ctx)
        of_parameters = isinstance(node.value, ast.Name) and node.value.id == "p"
        if isinstance(node.value, ast.Tuple):
            raise self.of.refusal(node, "an entry of a tuple")
        way = "shared" if of_parameters and self.of.is_structural(node.slice) else "item"
        return _call(way, self.visit(node.value), self.visit(node.slice))

    @override
    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        if self.of.is_shared(node):
            return ast.BoolOp(node.op, [self.visit(value) for value in node.values])
        name = "both" if isinstance(node.op, ast.And) else "either"
        result, *others = (self.visit(value) for value in node.values)
        for other in others:
            result = _call(name, result, other)
        return result

    @override
    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:
        if isinstance(node.op, ast.Not) and not self.of.is_shared(node.operand):
            return _call("no", self.visit(node.operand))
        return ast.UnaryOp(node.op, self.visit(node.operand))

    @override
    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        if len(node.ops) == 1 or self.of.is_shared(node):
            return ast.Compare(self.visit(node.left), node.ops, [self.visit(part) for part in node.comparators])
        raise self.of.refusal(node, "a comparison of more than two values")

    @override
    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:
        out = self.of.fresh("choice")
        shared = self.of.is_shared(node.test)
        test = self.visit(node.test)
        body, first = self.of.expression(node.body)
        other, second = self.of.expression(node.orelse)
        if shared:
            self.before.append(ast.If(test, [*first, _assign(out, body)], [*second, _assign(out, other)]))
            return _name(out)
        for part in (part for way in (node.body, node.orelse) for part in ast.walk(way)):
            if isinstance(part, ast.Call) and not (isinstance(part.func, ast.Name) and part.func.id in _BUILT_IN):
                raise self.of.refusal(node, "a choice with a call in it")
        self.before += [*first, *second]
        return _call("where", test, body, other)


def _holds_structure(place: int) -> bool:
    return par.LOCKED <= place < par.SIZE and place not in par.FLOW_CONSTANTS


def _returns_last(body: Sequence[ast.stmt]) -> list[ast.stmt]:
    """The same statements, where those after a branch that always returns are moved into the other branch."""
    out: list[ast.stmt] = []
    for k, node in enumerate(body):
        if isinstance(node, ast.If):
            here, other, rest = _returns_last(node.body), _returns_last(node.orelse), list(body[k + 1 :])
            if rest and _always_returns(here):
                out.append(ast.copy_location(ast.If(node.test, here, _returns_last([*node.orelse, *rest])), node))
                return out
            if rest and any(_returns([node])):
                raise NoLaneForm(f"line {node.lineno}: a branch that ends the function in some of its cases only")
            out.append(ast.copy_location(ast.If(node.test, here, other), node))
        else:
            out.append(node)
    return out


def _outside_of_entries(node: ast.AST) -> Iterator[ast.AST]:
    """Parts of an expression, without what stands within entries of arrays: their values are no indices."""
    yield node
    if not isinstance(node, ast.Subscript):
        for part in ast.iter_child_nodes(node):
            yield from _outside_of_entries(part)


def _always_returns(body: Sequence[ast.stmt]) -> bool:
    last = body[-1] if body else None
    if isinstance(last, ast.If):
        return _always_returns(last.body) and _always_returns(last.orelse)
    return isinstance(last, ast.Return)


def _returns(body: Sequence[ast.stmt]) -> Iterator[ast.Return]:
    return (node for statement in body for node in ast.walk(statement) if isinstance(node, ast.Return))


def _set_names(body: Sequence[ast.stmt]) -> set[str]:
    nodes = (node for statement in body for node in ast.walk(statement))
    return {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}


def _name(name: str, store: bool = False) -> ast.Name:
    return ast.Name(name, ast.Store() if store else ast.Load())


def _assign(name: str, value: ast.expr) -> ast.Assign:
    return ast.Assign([_name(name, True)], value)


def _call(name: str, *arguments: ast.expr) -> ast.Call:
    return ast.Call(_name(name), list(arguments), [])


def _loaded(target: ast.expr) -> ast.expr:
    out = copy.deepcopy(target)
    for node in ast.walk(out):
        if hasattr(node, "ctx"):
            node.ctx = ast.Load()
    return out
