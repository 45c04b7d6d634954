"""Rules that every source file keeps: no explicit inverse, no normal equations, filters over the rank, nothing unsafe.

Guards E103, E301, E302 and E408 have no condition at run time: they are properties of the code, checked here.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np
import pytest

from loadid._inverse.convolved.path import SpectralPath
from loadid._inverse.path import FactoredPath
from loadid._inverse.spectral import LinesPath, compress, factor, posterior
from loadid.paths import LinearProblem, SVDPath
from structures._testing.spectra import padded_length

from .sources import PACKAGES, called, imports, modules, parsed, walked, within

Found = Iterator[tuple[int, str]]
Rule = Callable[[ast.Module, str], Found]
Cases = dict[Rule, tuple[str, ...]]
INVERSES = {"inv", "pinv", "pinvh", "tensorinv", "getI"}
PRODUCTS = {"dot", "matmul", "vdot"}
UNSAFE_MODULES = ("pickle", "_pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal")
UNSAFE_CALLS = {"eval", "exec"}
YAML = {"load", "load_all", "unsafe_load", "unsafe_load_all", "full_load", "full_load_all"}
MAY_PRINT = ("loadid.cli", "loadid._commands")  # the terminal's own modules


# -- the rules -------------------------------------------------------------------------------------------------------
def explicit_inverses(tree: ast.Module, module: str) -> Found:
    """E103: ``inv(A)``, ``np.linalg.pinv(A)``, ``A**-1`` of matrices, ``from scipy.linalg import inv``."""
    for node in walked(tree):
        if isinstance(node, ast.Call) and called(node) in INVERSES:
            yield node.lineno, f"explicit inverse {called(node)}(): factor once and solve"
        elif isinstance(node, ast.Call) and called(node) == "matrix_power" and _negative(node.args[-1]):
            yield node.lineno, "explicit inverse matrix_power(A, -1): factor once and solve"
        elif isinstance(node, ast.ImportFrom) and (bad := INVERSES & {a.name for a in node.names}):
            yield node.lineno, f"imports {', '.join(sorted(bad))}: factor once and solve"


def normal_equations(tree: ast.Module, module: str) -> Found:
    """E103: ``A.T @ A`` in any spelling; the condition number is squared."""
    for node in walked(tree):
        for left, right in _products(node):
            inside = _transposed(left)
            if inside is not None and ast.dump(inside) == ast.dump(right):
                name = ast.unparse(right)
                yield node.lineno, f"normal equations {name}.T @ {name}: take SVD, QR or [H; lam L]"  # type: ignore[attr-defined]


def unsafe(tree: ast.Module, module: str) -> Found:
    """Nothing unpickles, evaluates text or loads YAML objects."""
    for node in walked(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in UNSAFE_CALLS:
            yield node.lineno, f"{node.func.id}() runs text"
        elif isinstance(node, ast.Attribute) and _name(node.value) == "yaml" and node.attr in YAML:
            yield node.lineno, f"yaml.{node.attr} builds objects: use safe_load"
        elif isinstance(node, ast.keyword) and node.arg == "allow_pickle" and not _is(node.value, False):
            yield node.value.lineno, "allow_pickle unpickles"
    for name in sorted(imports(tree, module)):
        if any(within(name, m) for m in UNSAFE_MODULES) or name in {f"yaml.{y}" for y in YAML}:
            yield 1, f"imports {name}"


def prints(tree: ast.Module, module: str) -> Found:
    """The library logs; only the command line prints."""
    if any(within(module, door) for door in MAY_PRINT):
        return
    for node in walked(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("print", "pprint"):
            yield node.lineno, f"{node.func.id}() in a library: log instead"
        elif isinstance(node, ast.Attribute) and node.attr in ("stdout", "stderr") and _name(node.value) == "sys":
            yield node.lineno, f"sys.{node.attr} in a library: log instead"


RULES: tuple[Rule, ...] = (explicit_inverses, normal_equations, unsafe, prints)


@pytest.mark.parametrize("rule", RULES, ids=lambda r: r.__name__)
def test_the_sources_keep_the_rule(rule: Rule) -> None:
    folders = (*PACKAGES, "case_studies") if rule is unsafe else PACKAGES
    found = [
        f"{path}:{line}: {text}" for module, path in modules(*folders) for line, text in rule(parsed(path), module)
    ]
    assert not found, "\n".join(found)


OFFENDERS: Cases = {
    explicit_inverses: (
        "np.linalg.inv(K)", "x = scipy.linalg.inv(K) @ f", "inv(K)", "np.linalg.pinv(H)",
        "from scipy.linalg import inv as i",
        "from numpy.linalg import solve, pinv", "sparse.linalg.inv(K)", "np.linalg.matrix_power(A, -1)",
    ),
    normal_equations: (
        "A.T @ A", "H.conj().T @ H + lam**2 * I", "solve(self.H.T @ self.H, self.H.T @ y)", "H.T.conj() @ H",
        "np.dot(A.T, A)", "A.T.dot(A)", "np.matmul(H.mT, H)", "np.transpose(A) @ A", "A.transpose() @ A",
        "H.swapaxes(-1, -2) @ H", "lam * A.T @ A", "A.conj().transpose() @ A", "A.T @ A @ x",
    ),
    unsafe: (
        "eval('1 + 1')", "exec(text)", "import pickle", "from pickle import loads", "def f():\n    import pickle",
        "np.load(path, allow_pickle=True)", "np.load(path, allow_pickle=flag)", "import yaml\nyaml.load(text)",
        "from yaml import load", "import importlib\nimportlib.import_module('pickle')", "import shelve",
        "read = yaml.unsafe_load",
    ),
    prints: ("print(1)", "def f():\n    print('done', file=stream)", "sys.stdout.write('x')", "pprint(x)"),
}  # fmt: skip
CLEAN: Cases = {
    explicit_inverses: (
        "np.linalg.solve(K, f)", "gammaincinv(m, 0.95)", "inverse = X.T", "matrix_power(A, 3)", "'inv(K)'",
    ),
    normal_equations: (
        "H.T @ y", "phi.T @ (M @ phi)", "Q @ (Q.T @ x)", "b @ b.T", "B.T @ D @ B", "(A @ A).T", "A.T @ B",
        "A.conj() @ A", "self.H.T @ self.L",
    ),
    unsafe: (
        "model.eval()", "yaml.safe_load(text)", "np.load(path, allow_pickle=False)", "json.load(file)",
        "re.compile(text)",
    ),
    prints: ("log.info('x')", "fingerprint(1)", "self.print(x)", "sys.path"),
}  # fmt: skip


def _cases(table: Cases) -> list:
    return [pytest.param(rule, text, id=f"{rule.__name__}-{text}") for rule, texts in table.items() for text in texts]


@pytest.mark.parametrize(("rule", "text"), _cases(OFFENDERS))
def test_an_offence_is_caught(rule: Rule, text: str) -> None:
    assert list(rule(ast.parse(text), "structures.made_up"))


@pytest.mark.parametrize(("rule", "text"), _cases(CLEAN))
def test_what_is_right_passes(rule: Rule, text: str) -> None:
    assert list(rule(ast.parse(text), "structures.made_up")) == []


@pytest.mark.parametrize("module", ["loadid.cli", "loadid._commands.demo"])
def test_the_command_line_may_print(module: str) -> None:
    assert list(prints(ast.parse("print(1)"), module)) == []


# -- E302: a filter factor is phi, not phi / sigma --------------------------------------------------------------------
SIGMA = np.array([4.0, 1.0, 1e-3, 1e-7])


def path_of(sigma: np.ndarray = SIGMA) -> FactoredPath:
    return FactoredPath(sigma, np.ones_like(sigma), np.ones_like(sigma), 0.0, len(sigma))


@pytest.mark.parametrize("k", range(len(SIGMA)))
def test_a_filter_factor_is_one_half_where_sigma_equals_lambda(k: int) -> None:
    path = path_of()
    phi, rest = path._filter(np.array([SIGMA[k] / path.scale]))
    assert phi[0, k] == pytest.approx(0.5, rel=1e-12)
    assert rest[0, k] == pytest.approx(0.5, rel=1e-12)


def test_filter_factors_have_the_right_limits_and_no_unit() -> None:
    lam = 1e-2
    path = path_of()
    phi, rest = (x[0] for x in path._filter(np.array([lam / path.scale])))
    np.testing.assert_allclose(phi[2:], (SIGMA[2:] / lam) ** 2, rtol=2e-2)
    np.testing.assert_allclose(
        rest[:2], (lam / SIGMA[:2]) ** 2, rtol=2e-4
    )  # formed directly: 1 - phi has no digits left
    np.testing.assert_allclose(phi + rest, 1.0, rtol=1e-14)
    assert all(a > b for a, b in pairwise(phi))
    other = path_of(1e6 * SIGMA)
    np.testing.assert_allclose(other._filter(np.array([lam / path.scale]))[0][0], phi, rtol=1e-12)


def test_the_coefficient_of_the_load_is_sigma_over_sigma_squared_plus_lambda_squared() -> None:
    path, lam = path_of(), 1e-2
    np.testing.assert_allclose(path.gains(lam / path.scale), SIGMA / (SIGMA**2 + lam**2), rtol=1e-12)


# -- E301: sums run over the rank, not over n -------------------------------------------------------------------------
LAMBDAS = [0.0, 1e-30, 1e-16, 1e-13, 1e-9, 1e-3]  # relative; the small ones divide rounding by rounding if n is summed


def deficient(rows: int, columns: int, kept: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """U (rows, r), V (columns, r) of orthonormal columns, and H = U diag(kept) V^T of rank r."""
    rng = np.random.default_rng(1)
    U = np.linalg.qr(rng.standard_normal((rows, len(kept))))[0]
    V = np.linalg.qr(rng.standard_normal((columns, len(kept))))[0]
    return U, V, (U * kept) @ V.T


@pytest.mark.parametrize("lam", LAMBDAS)
@pytest.mark.parametrize("size", [(9, 6), (4, 7)])
def test_a_rank_deficient_problem_is_solved_over_its_rank(lam: float, size: tuple[int, int]) -> None:
    kept = np.array([3.0, 2.0, 0.5])
    U, V, H = deficient(*size, kept)
    y = np.random.default_rng(2).standard_normal(size[0])
    path = SVDPath(LinearProblem.whitened(H, y))
    expected = V @ (kept / (kept**2 + (3 * lam) ** 2) * (U.T @ y))
    assert path.rank == 3
    np.testing.assert_allclose(path.solution(lam, None).load, expected, atol=1e-11)
    point = path.at(lam)
    assert point.edf == pytest.approx(np.sum(kept**2 / (kept**2 + (3 * lam) ** 2)), abs=1e-9)
    assert point.residual2 == pytest.approx(np.sum((y - H @ expected) ** 2), rel=1e-9)


@pytest.mark.parametrize("lam", LAMBDAS)
def test_a_load_without_a_trace_stays_zero(lam: float) -> None:
    H = np.diag([2.0, 1.0, 0.0])
    load = SVDPath(LinearProblem.whitened(H, np.ones(3))).solution(lam, None).load
    np.testing.assert_allclose(load, [2 / (4 + 4 * lam**2), 1 / (1 + 4 * lam**2), 0], atol=1e-12)


@pytest.mark.parametrize("lam", LAMBDAS)
def test_two_loads_that_look_alike_share_a_line(lam: float) -> None:
    rng = np.random.default_rng(3)
    h = rng.standard_normal((5, 3)) + 1j * rng.standard_normal((5, 3))
    H, Y = np.stack([h, h], axis=-1), h * (2 + 1j)
    lines = factor(compress(H, Y), np.ones((len(H), 2)))
    G = posterior(lines, (lam * LinesPath(lines).scale) ** 2).load[..., 0]
    np.testing.assert_allclose(G[:, 0], G[:, 1], atol=1e-11)
    np.testing.assert_allclose(G.sum(axis=1), (2 + 1j) / (1 + lam**2), atol=1e-11)


@pytest.mark.parametrize("lam", LAMBDAS)
def test_two_loads_that_look_alike_share_a_record(lam: float) -> None:
    samples = 40
    y = np.random.default_rng(4).standard_normal((samples, 2))
    padded = padded_length(samples)
    ones = np.ones((padded // 2 + 1, 2))
    load = SpectralPath(np.stack([ones, ones], axis=-1), y, ones).solution(lam, None).load
    expected = y.mean(axis=1) / 2 / (1 + lam**2)
    np.testing.assert_allclose(load, np.column_stack([expected, expected]), atol=1e-11)


# -- E408: the range of lambda for a general penalty is that of the generalised singular values ------------------------
@pytest.mark.parametrize("factor", [1e-5, 1.0, 1e5])
def test_the_range_of_lambda_is_that_of_both_matrices(factor: float) -> None:
    rng = np.random.default_rng(5)
    H, y = rng.standard_normal((12, 8)) * np.geomspace(1, 1e-3, 8), rng.standard_normal(12)
    L = np.diff(np.eye(8), axis=0)
    path = SVDPath(LinearProblem.whitened(H, y, L=factor * L))
    seen = H @ np.ones(8)  # the constant, which L does not see, is fitted first (Elden's standard form)
    rest = np.eye(12) - np.outer(seen, seen) / (seen @ seen)
    gamma = np.linalg.svd(rest @ H @ np.linalg.pinv(L), compute_uv=False)[:7]
    assert float(path.scale) * factor == pytest.approx(gamma[0], rel=1e-9)
    low, high = path.range
    assert high == 1.0
    assert low < gamma[-1] / gamma[0]
    assert float(path.scale) != pytest.approx(np.linalg.norm(H, 2), rel=1e-2)


# -- small readers of syntax -----------------------------------------------------------------------------------------
def _products(node: ast.AST) -> Iterator[tuple[ast.expr, ast.expr]]:
    """Neighbouring factors of a matrix product, in every spelling."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult):
        left = node.left
        while isinstance(left, ast.BinOp) and isinstance(left.op, ast.MatMult | ast.Mult):
            left = left.right  # (lam * A.T) @ A, (x @ A.T) @ A
        yield left, node.right
    elif isinstance(node, ast.Call) and called(node) in PRODUCTS:
        if len(node.args) == 2:
            yield node.args[0], node.args[1]
        elif len(node.args) == 1 and isinstance(node.func, ast.Attribute):
            yield node.func.value, node.args[0]


def _transposed(node: ast.expr) -> ast.expr | None:
    """X of ``X.T``, ``X.conj().T``, ``X.transpose()``, ``np.transpose(X)`` and their like, else None."""
    turned = False
    while True:
        if isinstance(node, ast.Attribute) and node.attr in ("T", "mT"):
            node, turned = node.value, True
        elif isinstance(node, ast.Call) and called(node) in (
            "transpose",
            "swapaxes",
            "conj",
            "conjugate",
            "conjugate_transpose",
        ):
            turned = turned or called(node) not in ("conj", "conjugate")
            own = isinstance(node.func, ast.Attribute) and _name(node.func.value) not in ("np", "numpy")
            node = node.func.value if own else node.args[0]  # type: ignore[attr-defined]
        else:
            return node if turned else None


def _negative(node: ast.expr) -> bool:
    return isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub)


def _is(node: ast.expr, value: object) -> bool:
    return isinstance(node, ast.Constant) and node.value is value


def _name(node: ast.expr) -> str:
    return node.id if isinstance(node, ast.Name) else ""
