"""Count the decision constants that no test pins: change one at a time and run the tests that should notice.

    python -m benchmarks.mutants [--seed 0] [--count 40] [--factors 1.3 0.7] [--only PATTERN] [--rows FILE.csv]
        [--limit SECONDS] [--list]

A decision constant is an int or a float other than 0 under an UPPER_CASE name of a module, alone or in a tuple, or the
default of a field of a frozen dataclass that is made by `option` or belongs to a class named Options, if some module
that can see it decides by it. The syntax tree shows that. The constant, a local name that was assigned from it, or an
argument whose default it is, stands

- on a side of an order comparison (an equality compares codes, not sizes), or
- in a call of where, clip, minimum, maximum, min or max, or
- in a keyword argument that is named as a limit, a tolerance or a weight,

where calls other than those of numpy and math hide what they contain. Constants of modules that draw are left out, and
so are names of versions, colours, text widths, decimals, sizes in memory, random seeds and codes.

The draw depends on the seed and on the name of a constant only, so that it changes by one where one constant goes.
Every mutant is a copy of the tree, by hard links to one copy of the checkout, with one number replaced. Compiled
kernels of the checkout are copied along; the key of a kernel covers the modules that its module imports, so a mutant
compiles the kernels again that can contain its constant, and its cache goes with it.

The tests of a mutant are the fast tests of the file that mirrors its module and of the files that import it or a module
that reads the constant; where no file mirrors it, also of those beside, if they reach it; where there are none at all,
of the files that import a module one step away, or two. Files come in this order, those with fewer imports first, until
the limit of CPU time, where the mutant counts as a survivor. A test that fails counts only if it passes without the
mutation. Run `make test` first: a kernel that the checkout has not compiled costs time of every mutant.
"""

from __future__ import annotations

import argparse
import ast
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache, cached_property
from hashlib import sha256
from math import ceil, floor
from pathlib import Path

import psutil

from benchmarks.support.row_files import append_row, read_rows
from models.core.module_discovery import find_discovered_packages, find_imports

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("models", "detectors", "diagnosis", "video", "pipeline")
CONSTANT_NAME = re.compile(r"_?[A-Z][A-Z0-9_]*")
# Modules whose constants are places and sizes in pictures and pages.
DRAWING = re.compile(r"^(video\.(overlay|drawing|rendering)|pipeline\.reporting\.(pages|recording|figures))\b")
NO_DECISION = re.compile(
    r"(^|_)(VERSION|COLOUR|COLOURS|WIDTH|CHARACTERS|LETTERS|DECIMALS|DIGITS|BYTES|MIB|SEED|CODE|DPI|FONT)(_|$)"
)
DECIDING_CALLS = {"where", "clip", "minimum", "maximum", "min", "max"}
DECIDING_ARGUMENT = re.compile(
    r"tol$|tolerance|limit|threshold|cutoff|bound|gate|weight|(^|_)(max|min|most|least)(_|imum)"
)
# Modules whose functions pass a constant on, as in `np.sqrt(MAX_CHI2)`.
OPEN_MODULES = {"np", "math", "torch"}
# Exit codes of pytest: all tests pass; there are only slow tests.
PASSED = (0, 5)
# Additional CPU time of a mutant whose module is compiled into kernels.
COMPILE_SECONDS = 300.0


@dataclass(frozen=True, slots=True)
class Constant:
    """A number of a module and its place in the source: first and last line (from 1) and column (bytes)."""

    module: str
    name: str
    value: float
    start: tuple[int, int]
    end: tuple[int, int]

    def __str__(self) -> str:
        return f"{self.module}.{self.name}"


@dataclass(frozen=True, slots=True)
class Row:
    """Result of a mutant."""

    constant: str
    old: str
    new: str
    files: int
    """Number of test files that were to run."""
    result: str
    """The first test that fails, or why the mutant survives."""
    killed: int
    seconds: float
    """CPU time."""


class SourceTree:
    """Modules of the product, their imports, and the tests that reach them."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.paths = {self.name_module(path): path for package in PACKAGES for path in (root / package).rglob("*.py")}
        self.tests = sorted((root / "tests").rglob("test_*.py"))
        self.support = {self.name_module(path).removeprefix("tests."): path
                        for path in (root / "tests").rglob("*.py") if path not in self.tests}  # fmt: skip

    def name_module(self, path: Path) -> str:
        return ".".join(path.relative_to(self.root).with_suffix("").parts).removesuffix(".__init__")

    @cached_property
    def imports(self) -> dict[str, set[str]]:
        """Modules that every module imports."""
        return {name: self.find_modules(path) for name, path in self.paths.items()}

    @cache  # noqa: B019  one tree per process
    def find_modules(self, path: Path) -> frozenset[str]:
        """Find the modules that a file imports, those of the modules in tests/ that it imports included."""
        source, found = path.read_bytes(), set[str]()
        package = self.name_module(path).split(".")[: None if path.name == "__init__.py" else -1]
        for dots, module, names in find_imports(source):
            full = ".".join([*package[: len(package) + 1 - dots], module]).strip(".") if dots else module
            found.update([full, *(f"{full}.{name}" for name in names)])
        for discovered in find_discovered_packages(source):
            found.update(name for name in self.paths if name.startswith(discovered))
        helpers = [self.support[name] for name in found if name in self.support and self.support[name] != path]
        return frozenset({name for name in found if name in self.paths}.union(*map(self.find_modules, helpers)))

    def find_readers(self, constant: Constant) -> set[str]:
        """Find the modules that read a constant: its own and importers in which its name occurs."""
        word = constant.name.split("[")[0].rpartition(".")[2]
        importers = [name for name, imported in self.imports.items() if constant.module in imported]
        return {constant.module} | {name for name in importers if word in self.find_words(name)}

    @cache  # noqa: B019  one tree per process
    def find_words(self, module: str) -> frozenset[str]:
        """Find the names in a module."""
        return frozenset(re.findall(r"\w+", self.paths[module].read_text()))

    def select_tests(self, constant: Constant) -> list[Path]:
        """Select the test files of a constant, in the order in which they run."""
        reached, own = self.find_readers(constant), constant.module.split(".")
        mirror = self.root.joinpath("tests", *own[:-1], f"test_{own[-1]}.py")
        near = set() if mirror in self.tests else {
            path for path in self.tests if path.parent == mirror.parent
            and any(constant.module in self.find_closure(name) for name in self.find_modules(path))
        }  # fmt: skip
        for _ in range(3):
            chosen = near.union(path for path in self.tests if path == mirror or self.find_modules(path) & reached)
            if chosen:
                return sorted(
                    chosen, key=lambda path: self.rank_test(path, path == mirror, path in near, constant.module)
                )
            reached |= {name for name, imported in self.imports.items() if imported & reached}
        return []

    def rank_test(self, path: Path, mirrors: bool, is_near: bool, module: str) -> tuple[bool, bool, bool, int, Path]:
        """Rank a test file by how close it is to a module."""
        return not mirrors, module not in self.find_modules(path), not is_near, len(self.find_modules(path)), path

    def is_compiled(self, module: str) -> bool:
        """Whether a module, or one that imports it directly or indirectly, compiles kernels."""
        kernels = [name for name, path in self.paths.items() if b"@compile_kernel" in path.read_bytes()]
        return any(module in self.find_closure(name) for name in kernels)

    @cache  # noqa: B019  one tree per process
    def find_closure(self, module: str) -> frozenset[str]:
        """Find a module and those that it imports directly or indirectly."""
        found, waiting = {module}, [module]
        while waiting:
            new = self.imports[waiting.pop()] - found
            found |= new
            waiting += new
        return frozenset(found)


def _list_numbers(name: str, node: ast.expr) -> Iterator[tuple[str, ast.expr, float]]:
    """Yield name, syntax node and value of a number, or of the numbers of a tuple."""
    if isinstance(node, ast.Tuple):
        for k, item in enumerate(node.elts):
            yield from _list_numbers(f"{name}[{k}]", item)
    elif all(
        isinstance(n, ast.Constant | ast.BinOp | ast.UnaryOp | ast.operator | ast.unaryop) for n in ast.walk(node)
    ):
        value = eval(compile(ast.Expression(node), "", "eval"), {"__builtins__": {}})
        if type(value) in (int, float) and value:
            yield name, node, value


def find_constants(tree: SourceTree, module: str) -> list[Constant]:
    """Find the numbers of a module that have a name, whether they decide or not."""
    found = list[tuple[str, ast.expr, float]]()
    for node in ast.parse(tree.paths[module].read_text()).body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            if isinstance(target, ast.Name) and CONSTANT_NAME.fullmatch(target.id):
                found += _list_numbers(target.id, node.value)
            elif isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                for one, value in zip(target.elts, node.value.elts, strict=True):
                    found += _list_numbers(ast.unparse(one), value)
        elif isinstance(node, ast.ClassDef) and "frozen=True" in " ".join(map(ast.unparse, node.decorator_list)):
            for field in node.body:
                if isinstance(field, ast.AnnAssign) and field.value is not None:
                    is_option = isinstance(field.value, ast.Call) and ast.unparse(field.value.func) == "option"
                    value = field.value.args[0] if is_option and field.value.args else field.value  # type: ignore[attr-defined]
                    if is_option or node.name.endswith("Options"):
                        found += _list_numbers(f"{node.name}.{ast.unparse(field.target)}", value)
    return [
        Constant(module, name, value, (node.lineno, node.col_offset), (node.end_lineno or 0, node.end_col_offset or 0))
        for name, node, value in found
    ]


def _find_open_names(node: ast.AST) -> set[str]:
    """Find names and attributes of an expression, except those within calls that hide their arguments."""
    if isinstance(node, ast.Call):
        called = node.func
        is_open = isinstance(called, ast.Attribute) and ast.unparse(called.value) in OPEN_MODULES
        if not is_open and not (
            isinstance(called, ast.Name) and called.id in DECIDING_CALLS | {"abs", "float", "int", "any", "all"}
        ):
            return set()
    if isinstance(node, ast.Subscript):  # an index does not decide
        return _find_open_names(node.value)
    own = (
        {node.id}
        if isinstance(node, ast.Name)
        else {f".{node.attr}", node.attr}
        if isinstance(node, ast.Attribute)
        else set()
    )
    return own.union(*map(_find_open_names, ast.iter_child_nodes(node)))


def find_deciding_names(source: str) -> set[str]:
    """Find the names and `.attributes` by which a module decides something."""
    deciding, sources = set[str](), dict[str, set[str]]()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Compare) and any(
            isinstance(op, ast.Lt | ast.LtE | ast.Gt | ast.GtE) for op in node.ops
        ):
            deciding |= _find_open_names(node)
        elif isinstance(node, ast.Call):
            name = ast.unparse(node.func).rpartition(".")[2]
            for value in node.args if name in DECIDING_CALLS else ():
                deciding |= _find_open_names(value)
            for keyword in node.keywords:
                if name in DECIDING_CALLS or DECIDING_ARGUMENT.search(keyword.arg or ""):
                    deciding |= _find_open_names(keyword.value)
        elif isinstance(node, ast.Assign | ast.AnnAssign | ast.NamedExpr) and node.value is not None:
            for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
                if isinstance(target, ast.Name):
                    sources.setdefault(target.id, set()).update(_find_open_names(node.value))
        elif isinstance(node, ast.arguments):
            plain = [*node.posonlyargs, *node.args]
            for argument, default in [*zip(plain[len(plain) - len(node.defaults) :], node.defaults, strict=True),
                                      *zip(node.kwonlyargs, node.kw_defaults, strict=True)]:  # fmt: skip
                if default is not None:
                    sources.setdefault(argument.arg, set()).update(_find_open_names(default))
    return deciding.union(*(names for local, names in sources.items() if local in deciding))


def list_decision_constants(tree: SourceTree) -> list[Constant]:
    """List the constants that decide something, in the order of their names."""
    deciding = {name: find_deciding_names(path.read_text()) for name, path in tree.paths.items()}
    found = []
    for module in sorted(tree.paths):
        if DRAWING.search(module):
            continue
        for constant in find_constants(tree, module):
            base = constant.name.split("[")[0]
            known = base if "." not in base else "." + base.rpartition(".")[2]
            readers = tree.find_readers(constant) if "." not in base else set(tree.paths)
            if not NO_DECISION.search(base.upper()) and any(known in deciding[name] for name in readers):
                found.append(constant)
    return found


def _draw(*key: object) -> int:
    return int.from_bytes(sha256(" ".join(map(str, key)).encode()).digest()[:8])


def draw_mutants(
    constants: Sequence[Constant], seed: int, count: int, factors: Sequence[float]
) -> list[tuple[Constant, float]]:
    """Draw constants, one number of each tuple, and their new values."""
    by_name: dict[str, list[Constant]] = {}
    for one in constants:
        by_name.setdefault(str(one).split("[")[0], []).append(one)
    names = sorted(by_name, key=lambda name: _draw(seed, name))[:count]
    drawn = [by_name[name][_draw(seed, name, "item") % len(by_name[name])] for name in names]
    return [(one, change(one.value, factors[_draw(seed, one, "factor") % len(factors)])) for one in drawn]


def change(value: float, factor: float) -> float:
    """Multiply a value; an integer is rounded away from the old one."""
    new = value * factor
    return (ceil(new) if new > value else floor(new)) if isinstance(value, int) else float(f"{new:.12g}")


def copy_tree(root: Path, target: Path) -> None:
    """Copy the files that git knows or would add, and the compiled kernels."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=root,
        check=True,
        capture_output=True,
    )
    kernels = [path.relative_to(root) for package in PACKAGES for path in (root / package).rglob("*.nb[ic]")]
    for relative in {*map(Path, filter(None, listed.stdout.decode().split("\0"))), *kernels}:
        if (root / relative).is_file():
            (target / relative).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(root / relative, target / relative)


def write_mutant(path: Path, constant: Constant, new: float) -> None:
    """Replace a number in a file; the old content, to which other trees link, stays as it is."""
    lines = path.read_bytes().splitlines(keepends=True)
    (row, left), (last, right) = constant.start, constant.end
    lines[row - 1 : last] = [lines[row - 1][:left] + repr(new).encode() + lines[last - 1][right:]]
    path.unlink()
    path.write_bytes(b"".join(lines))
    for compiled in path.parent.glob(f"__pycache__/{path.stem}.*.pyc"):
        compiled.unlink()


def run_tests(folder: Path, tests: Sequence[str], limit: float) -> tuple[bool | None, str, float]:
    """Run test files in a tree.

    Args:
        folder: The tree.
        tests: Test files or tests of it, and options of pytest.
        limit: CPU time, s, of pytest and what it starts; forty times as much may elapse, on a loaded machine.

    Returns:
        Whether all tests pass (None at the limit), the last lines of pytest, and the CPU time, s.
    """
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "--tb=no", "--hypothesis-seed=0"]
    environment = os.environ | {"PYTHONPATH": str(folder), "OMP_NUM_THREADS": "1"}
    with tempfile.TemporaryFile("w+") as output:
        done = psutil.Popen([*command, *tests], cwd=folder, env=environment, stdout=output, stderr=subprocess.STDOUT)
        used, latest, passes = 0.0, time.monotonic() + 40 * limit, None
        while used < limit and time.monotonic() < latest:
            used = max(used, measure_cpu_time(done))
            with suppress(psutil.TimeoutExpired):
                passes = done.wait(1.0) in PASSED
                break
        else:
            for process in [*done.children(recursive=True), done]:
                with suppress(psutil.NoSuchProcess):
                    process.kill()
            done.wait()
        output.seek(0)
        return passes, output.read(), used


def measure_cpu_time(process: psutil.Process) -> float:
    """Measure the CPU time of a process and its descendants, those that have ended included, s."""
    total = 0.0
    for one in [process, *process.children(recursive=True)]:
        with suppress(psutil.NoSuchProcess):
            total += sum(one.cpu_times()[:4])
    return total


def find_failure(passes: bool | None, text: str) -> str:
    """Find the first test that fails in the output of pytest."""
    if passes is None:
        return "out of time"
    failed = re.search(r"^(?:FAILED|ERROR) (.*?)( - .*)?$", text, re.MULTILINE)
    return "no test fails" if passes else failed[1] if failed else f"pytest: {' '.join(text.split())[-200:]}"


class Trial:
    """Runs mutants in copies of one copy of the checkout."""

    def __init__(self, tree: SourceTree, work: Path, limit: float) -> None:
        self.tree, self.limit, self.base = tree, limit, work / tree.root.name
        self.fails_unchanged: dict[str, bool] = {}
        copy_tree(tree.root, self.base)

    def link_tree(self, folder: Path) -> Path:
        """Copy the copy by hard links into a folder, with the footage beside it."""
        target = folder / self.base.name
        shutil.copytree(self.base, target, copy_function=os.link, symlinks=True)
        if (self.tree.root.parent / "shared").is_dir():
            (folder / "shared").symlink_to(self.tree.root.parent / "shared")
        return target

    def is_broken(self, test: str) -> bool:
        """Whether a test fails without a mutation."""
        if test not in self.fails_unchanged:
            self.fails_unchanged[test] = run_tests(self.base, [test], COMPILE_SECONDS)[0] is not True
        return self.fails_unchanged[test]

    def try_mutant(self, constant: Constant, new: float) -> Row:
        """Run the tests of a mutant; what also fails without the mutation is left out, and the others run again."""
        files = [str(path.relative_to(self.tree.root)) for path in self.tree.select_tests(constant)]
        limit = self.limit + (COMPILE_SECONDS if self.tree.is_compiled(constant.module) else 0.0)
        result, killed, seconds = "no test file imports it", False, 0.0
        with tempfile.TemporaryDirectory(dir=self.base.parent) as name:
            folder = self.link_tree(Path(name))
            write_mutant(folder / self.tree.paths[constant.module].relative_to(self.tree.root), constant, new)
            while files:
                broken = [test for test, fails in self.fails_unchanged.items() if fails]
                passes, text, used = run_tests(folder, [*files, *(f"--deselect={test}" for test in broken)], limit)
                result, killed, seconds = find_failure(passes, text), passes is False, seconds + used
                if not killed or result in broken or result.startswith("pytest:") or not self.is_broken(result):
                    break
        return Row(str(constant), repr(constant.value), repr(new), len(files), result, int(killed), round(seconds, 1))


def print_row(row: Row) -> None:
    """Print a line of the table."""
    cells = [row.constant, row.old, row.new, row.files, ("no", "yes")[row.killed], row.result, row.seconds]
    print(f"| {' | '.join(map(str, cells))} |", flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0, help="seed of the draw")
    parser.add_argument("--count", type=int, default=40, help="number of mutants")
    parser.add_argument("--factors", type=float, nargs="+", default=[1.3, 0.7], help="factors, of which one is drawn")
    parser.add_argument(
        "--only", default="*", metavar="PATTERN", help="only constants of this name, such as 'models.*'"
    )
    parser.add_argument(
        "--rows", type=Path, help="CSV of finished mutants of this tree, to continue an interrupted run"
    )
    parser.add_argument("--limit", type=float, default=60.0, help="CPU time of the tests of a mutant, s")
    parser.add_argument("--list", action="store_true", help="print the drawn mutants and their test files, and stop")
    arguments = parser.parse_args()
    tree = SourceTree(ROOT)
    constants = [one for one in list_decision_constants(tree) if fnmatchcase(str(one), arguments.only)]
    drawn = draw_mutants(constants, arguments.seed, arguments.count, arguments.factors)
    mutants = sorted(drawn, key=lambda one: tree.is_compiled(one[0].module))  # those that compile kernels take longest
    finished = {(row.constant, row.new): row for row in read_rows(arguments.rows, Row)}
    if arguments.list:
        for one, new in mutants:
            files = " ".join(str(path.relative_to(ROOT)) for path in tree.select_tests(one))
            print(f"{one}: {one.value!r} -> {new!r}: {files}")
        return 0
    print(f"{len(mutants)} mutants of {len(constants)} numbers that decide\n")
    print("| constant | old | new | test files | killed | by | CPU, s |")
    print("|---|---|---|---|---|---|---|")
    results = []
    with tempfile.TemporaryDirectory() as work:
        trial = Trial(tree, Path(work), arguments.limit)
        for one, new in mutants:
            row = finished.get((str(one), repr(new)))
            if row is None:
                row = trial.try_mutant(one, new)
                append_row(row, arguments.rows)
            print_row(row)
            results.append(row)
    killed = sum(row.killed for row in results)
    print(
        f"\n{killed} killed, {len(results) - killed} survived; {sum(row.seconds for row in results):.0f} s of CPU time"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
