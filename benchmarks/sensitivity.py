"""Show which thresholds of tracking and of the fit matter.

    python -m benchmarks.sensitivity [--module PATTERN] [--only NAME] [--shots N] [--seed S] [--share 0.3]
        [--cases PATTERN] [--jobs N] [--work DIR] [--rows FILE] [-o FILE.json]

Multiplies every numeric constant by 0.7 and by 1.3, runs the cases of the stress test again (sample clips, simulated
shots with damaged detections, and real clips where ../shared/data exists), and compares events and scores with the
unchanged run. A case is run again only where it calls a function that reads the constant. Numbers in arrays, dicts and
calls, such as `SearchOptions`, are left out. `--rows` keeps finished constants, so that a later run continues.
"""

from __future__ import annotations

import argparse
import ast
import importlib.util
import json
import pkgutil
import re
import signal
import sys
import time
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, is_dataclass
from fnmatch import fnmatchcase
from functools import cache, partial
from hashlib import sha256
from itertools import takewhile
from multiprocessing import get_context
from pathlib import Path
from types import FrameType, ModuleType
from typing import Any
from unittest.mock import patch

from pipeline.engine.process_setup import limit_library_threads

limit_library_threads()  # as the program does, before numpy is imported

import numpy as np  # noqa: E402

from benchmarks.stress_cases import stress_run  # noqa: E402
from benchmarks.stress_cases.case_scores import Case, Scores, score_case  # noqa: E402
from benchmarks.stress_cases.shot_truth import ShotTruth  # noqa: E402
from benchmarks.stress_cases.stress_chain import FittedShot, Recording  # noqa: E402
from benchmarks.stress_cases.synthetic_shots import draw_synthetic_shot, simulate_shots  # noqa: E402
from benchmarks.support.run_folder import FOOTAGE, ROOT  # noqa: E402
from models.core.events import Events  # noqa: E402
from models.core.options import FitOptions, TrackOptions  # noqa: E402
from models.core.tracks import Tracks  # noqa: E402
from models.core.typing import IntArray  # noqa: E402
from models.estimation.reconstruction.explain_shot import explain  # noqa: E402
from models.estimation.reconstruction.shot_views import view_shot  # noqa: E402
from models.tracking.build_tracks import build_tracks  # noqa: E402

# Packages whose constants are varied.
PACKAGES = ("models.tracking", "models.estimation.segmentation", "models.estimation.joint_fit",
            "models.estimation.structure_search", "models.estimation.reconstruction", "models.estimation.contact_test",
            "models.estimation.shot_hypotheses", "models.estimation.break_shot")  # fmt: skip
# Top-level packages in which imported names are patched as well.
ROOTS = ("models", "pipeline", "video", "detectors", "diagnosis", "benchmarks")
# Decorators of functions that keep the value that a constant had when they were compiled.
KERNEL = "compile_kernel"
# Names of indices, array sizes and seeds, which are no thresholds; the codes of `range(5)` are none either.
LAYOUT_NAME = re.compile(r"_(COLUMN|COUNT|SIZE|SEED)$")
# Words of constants that stay below 1: where the multiple would not, the value goes half of the way to 1.
AT_MOST_ONE = re.compile(r"probabilit|share|restitution|cosine|quantile|correlation", re.IGNORECASE)
# Largest distance in time of an event from itself in the unchanged run.
SAME_TIME_FRAMES = 0.5
# A case that takes longer than this multiple of its usual CPU time, plus these seconds, counts as a crash.
SLOWDOWN, SLOWDOWN_SECONDS = 10.0, 20.0
COLUMNS = ("constant", "value", "events changed, %", "sure events found", "false statements", "change of a probability",
           "cases that differ", "crashes", "unit and source")  # fmt: skip


@dataclass(frozen=True, slots=True)
class Constant:
    """A number of a module: the constant `name`, or the item of the tuple `name` at the indices `path`."""

    module: str
    name: str
    path: tuple[int, ...]
    value: float
    doc: str
    is_layout: bool = False

    def __str__(self) -> str:
        return f"{self.module.removeprefix('models.')}.{self.name}{''.join(f'[{k}]' for k in self.path)}"


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of a case: a digest of everything, sure true events found, and wrong statements that are not undecided."""

    tracks: Tracks
    events: Events
    digest: str
    found: int
    false: int


@dataclass(frozen=True, slots=True)
class Baseline:
    """A case and its unchanged result; `reads` holds file and name of what the tracking and the fit refer to."""

    name: str
    recording: Recording
    truth: ShotTruth
    kept: IntArray | None
    outcome: Outcome
    seconds: float
    reads: tuple[set[tuple[str, str]], ...]


@dataclass(slots=True)
class Effect:
    """What a value does in the `read` cases that read it: changed events `of` those of all cases, and other changes."""

    value: float
    changed: int = 0
    of: int = 0
    found: int = 0
    false: int = 0
    probability: float = 0.0
    differing: int = 0
    read: int = 0
    crashes: int = 0


@cache
def _parse(file: str) -> ast.Module:
    return ast.parse(Path(file).read_text(encoding="utf-8"))


def list_modules(roots: Sequence[str] = ROOTS) -> dict[str, ModuleType]:
    """List the loaded modules of top-level packages by name."""
    return {name: m for name, m in sys.modules.items() if name.split(".")[0] in roots and getattr(m, "__file__", None)}


def load_packages() -> list[ModuleType]:
    """Import all modules of `PACKAGES`: one that is imported later would copy changed values."""
    paths = {package: importlib.import_module(package).__path__ for package in PACKAGES}
    return [importlib.import_module(f"{p}.{m.name}") for p, path in paths.items() for m in pkgutil.iter_modules(path)]


def find_constants(module: ModuleType) -> list[Constant]:
    """Find UPPER_CASE floats, integers above 1, and those in tuples, with the comment above each."""
    lines, constants = Path(str(module.__file__)).read_text(encoding="utf-8").splitlines(), list[Constant]()
    for node in _parse(str(module.__file__)).body:
        if not isinstance(node, ast.Assign | ast.AnnAssign):
            continue
        above = takewhile(lambda line: line.startswith("#"), reversed(lines[: node.lineno - 1]))
        doc = " ".join(line.removeprefix("#").strip() for line in reversed([*above]))
        is_code = isinstance(node.value, ast.Call) and "range" in ast.dump(node.value.func)
        names = [n.id for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]
        for name in names:
            if re.fullmatch(r"_?[A-Z][A-Z0-9_]*", name) and name in vars(module):
                is_layout = is_code or bool(LAYOUT_NAME.search(name))
                numbers = _list_numbers(vars(module)[name])
                constants += [Constant(module.__name__, name, path, v, doc, is_layout) for path, v in numbers]
    return constants


def _list_numbers(value: object, path: tuple[int, ...] = ()) -> Iterator[tuple[tuple[int, ...], float]]:
    if isinstance(value, tuple):
        for k, item in enumerate(value):
            yield from _list_numbers(item, (*path, k))
    elif isinstance(value, float) or (isinstance(value, int) and value > 1):
        yield path, value


@cache
def _list_imports(file: str, package: str) -> list[tuple[str, str, str]]:
    """List module, name and local name of all that a file imports with `from`."""
    nodes = [node for node in ast.walk(_parse(file)) if isinstance(node, ast.ImportFrom)]
    sources = [importlib.util.resolve_name("." * node.level + (node.module or ""), package) for node in nodes]
    return [(s, a.name, a.asname or a.name) for s, node in zip(sources, nodes, strict=True) for a in node.names]


def find_bindings(module: str, name: str, roots: Sequence[str] = ROOTS) -> list[tuple[ModuleType, str]]:
    """Find the loaded modules that hold a constant, and its name there: its own, and those that import it."""
    modules, keys = list_modules(roots), [(module, name)]
    for key in keys:  # grows
        for other, loaded in modules.items():
            for source, imported, local in _list_imports(str(loaded.__file__), loaded.__package__ or ""):
                if (source, imported) == key and (other, local) not in keys:
                    keys.append((other, local))
    return [(modules[other], local) for other, local in keys]


@cache
def _list_uses(file: str) -> tuple[set[str], set[str], set[str]]:
    """List the names and `.attributes` that a file reads in compiled functions, in functions, and at import time."""
    functions = [
        f for f in ast.walk(_parse(file)) if isinstance(f, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
    ]
    kernels = [f for f in functions if re.search(KERNEL, " ".join(map(ast.dump, getattr(f, "decorator_list", []))))]
    bodies = [part for f in functions for part in (f.body if isinstance(f.body, list) else [f.body])]
    compiled, called, everything = (
        {n for part in parts for n in ast.walk(part) if isinstance(getattr(n, "ctx", None), ast.Load)}
        for parts in (kernels, bodies, [_parse(file)])
    )

    def list_names(nodes: set[ast.AST]) -> set[str]:
        names = {node.id for node in nodes if isinstance(node, ast.Name)}
        return names | {f".{node.attr}" for node in nodes if isinstance(node, ast.Attribute)}

    return list_names(compiled), list_names(called), list_names(everything - called)


def explain_exclusion(constant: Constant, roots: Sequence[str] = ROOTS) -> tuple[str, str]:
    """Explain why a constant is not varied, or add a remark on one that is; both may be empty."""
    places = [(m, f".{constant.name}") for m in list_modules(roots).values()]
    places += find_bindings(constant.module, constant.name, roots)
    in_kernel, in_function, at_import = (any(n in _list_uses(str(m.__file__))[k] for m, n in places) for k in range(3))
    if constant.is_layout or in_kernel:
        return "index, size, code or seed, not varied" if constant.is_layout else "compiled, not varied", ""
    if not in_function:
        return "used at import time only (default, other constant), not varied" if at_import else "never used", ""
    return "" if constant.value else "zero, not varied", "its copy from import time is not varied" if at_import else ""


def vary(constant: Constant, factor: float) -> float:
    """Multiply a value; integers change by at least 1, and probabilities and the like stay below 1."""
    value, old = constant.value * factor, constant.value
    if isinstance(old, int):
        return max(1, min(round(value), old - 1) if factor < 1 else max(round(value), old + 1))
    return (1 + old) / 2 if 0 < old < 1 <= value and AT_MOST_ONE.search(constant.name + constant.doc) else value


@contextmanager
def patch_constant(constant: Constant, value: float, roots: Sequence[str] = ROOTS) -> Iterator[None]:
    """Set a constant in all modules that hold it, and restore it, also in modules that were loaded meanwhile."""

    def replace_item(item: Any, path: tuple[int, ...]) -> Any:
        return (*item[: path[0]], replace_item(item[path[0]], path[1:]), *item[path[0] + 1 :]) if path else value

    def rebind(before: object, after: object) -> None:
        for module, local in find_bindings(constant.module, constant.name, roots):
            if vars(module).get(local) is before:
                setattr(module, local, after)
        for module in list_modules(roots).values():  # forget what `functools.cache` has computed
            for function in [one for one in vars(module).values() if hasattr(one, "cache_clear")]:
                function.cache_clear()

    old = vars(sys.modules[constant.module])[constant.name]
    new = replace_item(old, constant.path)
    try:
        rebind(old, new)
        yield
    finally:
        rebind(new, old)


@contextmanager
def record_reads() -> Iterator[set[tuple[str, str]]]:
    """Record file and name of all globals and attributes that the called functions refer to."""
    codes, reads = set(), set[tuple[str, str]]()
    sys.setprofile(lambda frame, event, _: codes.add(frame.f_code) if event == "call" else None)
    try:
        yield reads
    finally:
        sys.setprofile(None)
        reads.update((code.co_filename, name) for code in codes for name in code.co_names)


def digest(value: object) -> str:
    """Hash a value: dataclasses, sequences and arrays by their content."""
    if isinstance(value, np.ndarray):
        return sha256(value.tobytes()).hexdigest()
    if is_dataclass(value):
        value = [getattr(value, field.name) for field in fields(value)]
    return sha256(
        (" ".join(map(digest, value)) if isinstance(value, list | tuple) else repr(value)).encode()
    ).hexdigest()


def evaluate(recording: Recording, tracks: Tracks, truth: ShotTruth, kept: IntArray | None) -> Outcome:
    """Fit tracks and score the result."""
    fit = view_shot(explain(tracks, recording.scene, FitOptions()))
    scores = score_case(Case("", "", "", 0), FittedShot(recording, tracks, fit), truth, kept)
    false = sum(s.is_true == (s.probability < 0.5) and not s.undecided for s in scores.statements)
    found = sum(s.found for s in scores.sought)
    return Outcome(tracks, fit.events, digest([tracks, fit, scores.statements]), found, false)


def track_balls(recording: Recording) -> Tracks:
    """Track a recording with default options."""
    return build_tracks(recording.detections, recording.frame, recording.t, recording.scene, TrackOptions())


def measure_baseline(name: str, recording: Recording, truth: ShotTruth, kept: IntArray | None) -> Baseline:
    """Run a case twice with unchanged constants: to see what it reads, and to measure its time."""
    with record_reads() as track_reads:
        tracks = track_balls(recording)
    with record_reads() as fit_reads:
        outcome = evaluate(recording, tracks, truth, kept)
    start = time.process_time()
    if evaluate(recording, track_balls(recording), truth, kept).digest != outcome.digest:
        print(f"{name} differs from run to run", file=sys.stderr)
    return Baseline(name, recording, truth, kept, outcome, time.process_time() - start, (track_reads, fit_reads))


def collect_cases(shots: int, seed: int, pattern: str, work: Path) -> list[Baseline]:
    """Let the stress test make its cases, named `real CLIP`, `sample CLIP` and `shot NAME`, and run them unchanged."""
    cases, folder = list[Baseline](), work / "shots"
    clean, damaged = (stress_run.Plan(names, seed, work) for names in ((stress_run.NONE,), stress_run.DAMAGES))

    def capture(case: Case, shot: FittedShot, truth: ShotTruth, kept: IntArray | None = None) -> Scores:
        cases.append(measure_baseline(f"{case.clip} {case.damage}", shot.recording, truth, kept))
        return Scores(cases=[case])

    drawn = [draw_synthetic_shot(seed, k) for k in range(shots)]
    simulate_shots([shot for shot in drawn if re.search(pattern, f"shot {shot.name}")], folder)
    tasks = [(f"shot {shot.name}", partial(stress_run.run_synthetic, k, damaged)) for k, shot in enumerate(drawn)]
    for kind, place in (("sample", stress_run.SAMPLES), ("real", FOOTAGE)):
        runs = [
            partial(stress_run.run_clip, clip, ("real", "synthetic"), clean) for clip in sorted(place.glob("*.mp4"))
        ]
        tasks += [(f"{kind} {run.args[0].stem}", run) for run in runs]
    with patch.object(stress_run, "score_case", capture):
        for scores in [task() for name, task in tasks if re.search(pattern, name)]:
            print("".join(f"{text}\n" for text in [*scores.skipped, *scores.crashes]), end="", file=sys.stderr)
    return cases


def count_changed(old: Events, new: Events) -> tuple[int, int, float]:
    """Count events of only one of two lists, and all; and compute the largest change of a probability of the others.

    An event is the same with the same kind and balls, half a frame away at most.
    """
    keys = [[(e.kind[k], *sorted((e.a[k], e.b[k]))) for k in range(len(e))] for e in (old, new)]
    pairs = [
        (abs(old.frame[i] - new.frame[j]), i, j) for i, a in enumerate(keys[0]) for j, b in enumerate(keys[1]) if a == b
    ]
    matched: dict[int, int] = {}
    for away, i, j in sorted(pairs):
        if away <= SAME_TIME_FRAMES and i not in matched and j not in matched.values():
            matched[i] = j
    change = max((float(abs(old.probability[i] - new.probability[j])) for i, j in matched.items()), default=0.0)
    return len(old) + len(new) - 2 * len(matched), len(old) + len(new) - len(matched), change


def _stop(number: int, frame: FrameType | None) -> None:
    raise TimeoutError("much slower than unchanged")


def measure_effect(constant: Constant, value: float, cases: Sequence[Baseline]) -> Effect:
    """Run the cases that read a constant with another value of it."""
    effect = Effect(value)
    names = {(str(m.__file__), local) for m, local in find_bindings(constant.module, constant.name)}
    signal.signal(signal.SIGVTALRM, _stop)
    with patch_constant(constant, value), warnings.catch_warnings(action="ignore"):
        for case in cases:
            old, new = case.outcome, case.outcome
            in_tracking, in_fit = (not names.isdisjoint(reads) for reads in case.reads)
            try:
                signal.setitimer(signal.ITIMER_VIRTUAL, SLOWDOWN * case.seconds + SLOWDOWN_SECONDS)
                tracks = track_balls(case.recording) if in_tracking else old.tracks
                if in_fit or digest(tracks) != digest(old.tracks):
                    new = evaluate(case.recording, tracks, case.truth, case.kept)
            except Exception as error:  # a crash is a result here
                print(f"{constant} = {value:g}: {case.name}: {type(error).__name__}: {error}", file=sys.stderr)
                effect.crashes += 1
            finally:
                signal.setitimer(signal.ITIMER_VIRTUAL, 0)
            changed, of, change = count_changed(old.events, new.events)
            effect.changed, effect.of = effect.changed + changed, effect.of + of
            effect.found, effect.false = effect.found + new.found - old.found, effect.false + new.false - old.false
            effect.differing, effect.read = (
                effect.differing + (new.digest != old.digest),
                effect.read + (in_tracking or in_fit),
            )
            effect.probability = max(effect.probability, change)
    return effect


def measure_constant(constant: Constant, share: float, cases: Sequence[Baseline]) -> list[Effect]:
    """Measure the effects of a smaller and of a larger value."""
    return [measure_effect(constant, vary(constant, factor), cases) for factor in (1 - share, 1 + share)]


def format_report(rows: Sequence[tuple[Constant, str, str, Sequence[Effect]]]) -> str:
    """Format a table in the order of the effect, and the lists of constants without one.

    Args:
        rows: Constants, why they are not varied, remarks, and the effects of a smaller and of a larger value.

    Returns:
        Text in Markdown; cells hold the effects of both values.
    """
    lines, lists = list[tuple[tuple[float, ...], str]](), dict[str, list[str]]()
    for constant, reason, remark, effects in rows:
        shares = [100 * e.changed / max(e.of, 1) for e in effects]
        if not reason and not any(e.differing or e.crashes for e in effects):
            reason = "no effect: candidate for removal" if effects[0].read else "no case calls a function that reads it"
            remark = f"read in {effects[0].read} cases" + (remark and f"; {remark}") if effects[0].read else remark
        doc = constant.doc + (remark and f" ({remark})")
        if reason:
            lists.setdefault(reason, []).append(f"- {constant} = {constant.value:g}: {doc}")
            continue
        cells = [
            f"{constant.value:g} -> " + ", ".join(f"{e.value:.4g}" for e in effects),
            " / ".join(f"{one:.1f}" for one in shares),
            " / ".join(f"{e.found:+d}" for e in effects),
            " / ".join(f"{e.false:+d}" for e in effects),
            " / ".join(f"{e.probability:.3f}" for e in effects),
            " / ".join(f"{e.differing}" for e in effects) + f" of {effects[0].read}",
            " / ".join(f"{e.crashes}" for e in effects),
        ]
        order = (
            max(shares),
            max(abs(e.found) + abs(e.false) + e.crashes for e in effects),
            max(e.probability for e in effects),
        )
        lines.append((order, f"| {constant} | {' | '.join(cells)} | {doc} |"))
    text = [f"| {' | '.join(COLUMNS)} |", "|---" * len(COLUMNS) + "|"]
    text += [*(line for _, line in sorted(lines, key=lambda one: one[0], reverse=True))]
    for reason, names in sorted(lists.items()):
        text += ["", f"## {reason[0].upper()}{reason[1:]} ({len(names)})", "", *names]
    return "\n".join(text)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--module", default="", help="only modules whose name contains this pattern")
    parser.add_argument(
        "--only", default="*", metavar="NAME", help="only constants of this name; * stands for any letters"
    )
    parser.add_argument("--shots", type=int, default=20, help="number of simulated shots")
    parser.add_argument("--seed", type=int, default=0, help="seed of the simulated shots and of their damages")
    parser.add_argument("--share", type=float, default=0.3, help="relative change of a constant, between 0 and 1")
    parser.add_argument(
        "--cases",
        default="",
        metavar="PATTERN",
        help="regular expression of cases, such as '^(sample|shot)' or '^(?!.*break)'",
    )
    parser.add_argument("--jobs", type=int, default=1, help="number of processes")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "stress", help="folder of simulated shots")
    parser.add_argument("--rows", type=Path, help="JSON lines of finished constants, to continue an interrupted run")
    parser.add_argument("-o", "--out", type=Path, help="JSON file of all rows")
    arguments = parser.parse_args()
    constants = [one for module in load_packages() if fnmatchcase(module.__name__, f"*{arguments.module}*")
                 for one in find_constants(module) if fnmatchcase(one.name, arguments.only)]  # fmt: skip
    excluded = {one: explain_exclusion(one) for one in constants}
    cases = collect_cases(arguments.shots, arguments.seed, arguments.cases, arguments.work.absolute())
    settings = digest([arguments.share, [(case.name, case.outcome.digest) for case in cases]])
    effects: dict[str, list[Effect]] = {}
    if arguments.rows and arguments.rows.is_file():
        for row in map(json.loads, arguments.rows.read_text().splitlines()):
            if row["settings"] == settings:  # else another share, other cases, or changed code
                effects[row["key"]] = [Effect(**effect) for effect in row["effects"]]
    pending = [one for one in constants if not excluded[one][0] and f"{one} = {one.value!r}" not in effects]
    seconds = 2 * len(pending) * sum(case.seconds for case in cases)
    print(f"{len(pending)} of {len(constants)} constants to vary in {len(cases)} cases: at most {seconds / 60:.1f} min "
          "of CPU time", file=sys.stderr)  # fmt: skip
    measure = partial(measure_constant, share=arguments.share, cases=cases)
    with ProcessPoolExecutor(arguments.jobs, get_context("spawn"), load_packages) as pool:
        measured = map(measure, pending) if arguments.jobs <= 1 else pool.map(measure, pending)
        for k, (one, both) in enumerate(zip(pending, measured, strict=True), start=1):
            effects[f"{one} = {one.value!r}"] = both
            print(f"{k}/{len(pending)} {one}", file=sys.stderr)
            if arguments.rows:
                row = {"settings": settings, "key": f"{one} = {one.value!r}", "effects": [asdict(e) for e in both]}
                with arguments.rows.open("a") as file:
                    file.write(json.dumps(row) + "\n")
    rows = [(one, *excluded[one], effects.get(f"{one} = {one.value!r}", [])) for one in constants]
    if arguments.out:
        content = [
            asdict(one) | {"excluded": why, "remark": remark, "effects": [asdict(e) for e in both]}
            for one, why, remark, both in rows
        ]
        arguments.out.write_text(json.dumps({"cases": [case.name for case in cases], "rows": content}, indent=1) + "\n")
    print(format_report(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
