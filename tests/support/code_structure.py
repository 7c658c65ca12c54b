"""Measures of the source tree: names, sizes, import cycles and docstrings.

Run it on one or more checkouts to compare them:

    python tests/support/code_structure.py . ../an-older-checkout
"""

from __future__ import annotations

import ast
import re
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

PACKAGES = ("trueroll", "pipeline", "detectors", "diagnosis", "video", "models")
"""The packages that are installed, from the top layer to the bottom."""
SHARED_BASE_NAMES = {"__init__", "__main__", "options"}
"""Base names that may occur more than once: required by Python, or the same thing in every package."""
DENIED_NAMES = frozenset({"told", "said", "seen", "known", "found", "held", "kept", "tried", "asked", "listed"})
"""Participles that do not say what a variable holds."""
IRREGULAR = (
    r"told|said|seen|known|found|held|kept|made|given|taken|left|shown|drawn|built|met|"
    r"gone|done|lost|begun|grown|thrown|meant|sent|spent|bent|sought|brought|thought|caught|"
    r"taught|torn|written|hidden|broken|chosen|frozen|spoken|stolen|beaten|fallen|forgotten|"
    r"risen|shaken|laid|paid|heard|hung|stuck|struck|swept|felt|dealt|won|bound|wound|spun"
)
"""Participles that do not end in -ed."""
PARTICIPLE = re.compile(rf"(?:[a-z]+ed|{IRREGULAR})(?:_|$)")
VERBS_IN_ED = re.compile(r"(?:need|feed|seed|embed|speed|proceed|exceed|shed)(?:_|$)")
"""Words that end in -ed and are no participles."""

Functions = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True, slots=True)
class Module:
    """One parsed module of the product."""

    name: str
    """Dotted, as it is imported."""
    path: Path
    lines: int
    code_lines: int
    """Lines that hold code: neither blank, comment nor docstring."""
    tree: ast.Module

    @property
    def package(self) -> str:
        """The package that holds the module; of a package, itself."""
        return self.name if self.path.name == "__init__.py" else self.name.rpartition(".")[0]

    def functions(self) -> Iterator[Functions]:
        """Yield all functions and methods but dunder methods."""
        for node in ast.walk(self.tree):
            if isinstance(node, Functions) and not node.name.startswith("__"):
                yield node

    def classes(self) -> Iterator[ast.ClassDef]:
        """Yield all classes."""
        return (node for node in ast.walk(self.tree) if isinstance(node, ast.ClassDef))


@cache
def read_modules(root: Path) -> tuple[Module, ...]:
    """Parse every module of the product below `root`."""
    modules = []
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
            source = path.read_text(encoding="utf-8")
            tree = ast.parse(source)
            modules.append(Module(name, path, source.count("\n"), count_code_lines(source, tree), tree))
    return tuple(modules)


def count_code_lines(source: str, tree: ast.Module) -> int:
    """Count the lines of a module that are neither blank, nor comments, nor strings that stand alone."""
    prose: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            prose.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    lines = enumerate(source.splitlines(), 1)
    return sum(1 for number, line in lines if number not in prose and line.strip() and not line.strip().startswith("#"))


def is_participle(name: str) -> bool:
    """Whether a function name begins with a participle."""
    bare = name.lstrip("_")
    return PARTICIPLE.match(bare) is not None and VERBS_IN_ED.match(bare) is None


def is_one_word(name: str) -> bool:
    """Whether a name is private and a single word."""
    return name.startswith("_") and "_" not in name.strip("_")


def denied_names(module: Module) -> Iterator[tuple[int, str]]:
    """Yield (line, name) of every parameter, field and variable on the deny list."""
    for node in ast.walk(module.tree):
        if isinstance(node, ast.arg) and node.arg in DENIED_NAMES:
            yield node.lineno, node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and node.id in DENIED_NAMES:
            yield node.lineno, node.id


def duplicate_base_names(modules: Iterable[Module]) -> dict[str, int]:
    """Count the file names that more than one module has."""
    return _repeated(m.path.stem for m in modules if m.path.stem not in SHARED_BASE_NAMES)


def duplicate_class_names(modules: Iterable[Module]) -> dict[str, int]:
    """Count the class names that are defined more than once."""
    return _repeated(node.name for module in modules for node in module.classes())


def names_bound_twice(module: Module) -> dict[str, int]:
    """Count the names that a module defines or assigns more than once at its top level, so that the last one wins."""
    names = []
    for node in module.tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.append(node.name)
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        for target in targets:
            elements = target.elts if isinstance(target, ast.Tuple) else [target]
            names += [element.id for element in elements if isinstance(element, ast.Name)]
    return _repeated(names)


def modules_per_folder(modules: Iterable[Module]) -> Counter[Path]:
    """Count the modules of every folder, without `__init__`."""
    return Counter(module.path.parent for module in modules if module.path.stem not in ("__init__", "__main__"))


def _repeated(names: Iterable[str]) -> dict[str, int]:
    return {name: count for name, count in Counter(names).items() if count > 1}


def import_graph(modules: Iterable[Module]) -> dict[str, set[str]]:
    """Map every module to the modules that it imports, imports inside functions included."""
    modules = tuple(modules)
    names = {module.name for module in modules}
    graph: dict[str, set[str]] = {}
    for module in modules:
        targets = set()
        for node in ast.walk(module.tree):
            if isinstance(node, ast.Import):
                targets.update(alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module:
                for alias in node.names:
                    below = f"{node.module}.{alias.name}"
                    targets.add(below if below in names else node.module)
        graph[module.name] = (targets & names) - {module.name}
    return graph


def package_graph(modules: Iterable[Module]) -> dict[str, set[str]]:
    """Map every package to the packages whose modules its own modules import; modules of subpackages do not count."""
    modules = tuple(modules)
    package_of = {module.name: module.package for module in modules}
    graph: dict[str, set[str]] = {package: set() for package in package_of.values()}
    for name, targets in import_graph(modules).items():
        graph[package_of[name]].update(package_of[target] for target in targets)
    return {package: targets - {package} for package, targets in graph.items()}


def find_cycles(graph: Mapping[str, set[str]]) -> list[list[str]]:
    """Find the strongly connected components of more than one node (Tarjan 1972, doi:10.1137/0201010).

    Args:
        graph: For every node, its successors, all of them nodes.

    Returns:
        The members of each component, sorted.
    """
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    components = []
    for root in graph:
        if root in index:
            continue
        work = [(root, iter(sorted(graph[root])))]
        index[root] = low[root] = len(index)
        stack.append(root)
        while work:
            node, successors = work[-1]
            for successor in successors:
                if successor not in index:
                    index[successor] = low[successor] = len(index)
                    stack.append(successor)
                    work.append((successor, iter(sorted(graph[successor]))))
                    break
                if successor in stack:
                    low[node] = min(low[node], index[successor])
            else:
                work.pop()
                if work:
                    low[work[-1][0]] = min(low[work[-1][0]], low[node])
                if low[node] == index[node]:
                    component = stack[stack.index(node) :]
                    del stack[stack.index(node) :]
                    if len(component) > 1:
                        components.append(sorted(component))
    return components


def summarize_structure(root: Path) -> dict[str, str]:
    """Measure the tree of one checkout; each value is text for a table."""
    modules = read_modules(root)
    functions = [node.name for module in modules for node in module.functions()]
    private = [name for name in functions if name.startswith("_")]
    participles = sum(map(is_participle, functions))
    one_word = sum(map(is_one_word, private))
    return {
        "modules": str(len(modules)),
        "lines": str(sum(module.lines for module in modules)),
        "lines of code": str(sum(module.code_lines for module in modules)),
        "functions": str(len(functions)),
        "functions that begin with a participle": _share(participles, len(functions)),
        "private functions of one word, of all functions": _share(one_word, len(functions)),
        "private functions of one word, of private ones": _share(one_word, len(private)),
        "variables on the deny list": str(sum(len(list(denied_names(module))) for module in modules)),
        "class names used twice or more": str(len(duplicate_class_names(modules))),
        "base names used twice or more": str(len(duplicate_base_names(modules))),
        "modules in the fullest folder": str(max(modules_per_folder(modules).values())),
        "import cycles of modules": str(len(find_cycles(import_graph(modules)))),
        "import cycles of packages": str(len(find_cycles(package_graph(modules)))),
    }


def _share(part: int, whole: int) -> str:
    return f"{part} ({part / max(whole, 1):.1%})"


def main() -> None:
    """Print the measures of the given checkouts side by side."""
    columns = [summarize_structure(Path(root).resolve()) for root in sys.argv[1:] or ["."]]
    for label in columns[0]:
        print(f"{label:60s}", *(f"{column[label]:>16s}" for column in columns))


if __name__ == "__main__":
    main()
