"""Draw the figures of the page that explains how a diagnosis decides, one per step, from one simulated example.

    python -m benchmarks.diagnosis.decision_figures [-o FOLDER]

Balls fly with air drag and a lift by their spin, simulated by `worlds`; the simulator under test has gravity alone.
The figures are PNG files in docs/images/diagnosis (default). Needs matplotlib (extra `dev`). About ten seconds.
"""

from __future__ import annotations

import argparse
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.diagnosis.gap_cases import GapCase, generate_cases
from benchmarks.diagnosis.gap_trial import play_case
from benchmarks.support.run_folder import ROOT
from diagnosis.diagnose import diagnose
from diagnosis.fitting.shot_preparation import ShotSplit, split_shots
from diagnosis.selection.hypotheses import compute_hypothesis_signatures, get_shot_information, ignore_progress
from diagnosis.selection.study import Study, run_study
from diagnosis.verdicts.verdict import DiagnosisReport
from pipeline.io.track_folder_scene import build_gap_scene
from pipeline.reporting.pages.gap_page import AFTER, BEFORE, compute_error_growth

CASE, SEED = "pair: flight, air drag and lift by spin", 2
GREY = "#7b837f"
SIZE = (6.4, 2.5)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "docs/images/diagnosis", help="folder of the figures")
    out: Path = parser.parse_args().out
    if find_spec("matplotlib") is None:
        parser.error("the figures need matplotlib; install trueroll with the extra dev: pip install -e '.[dev]'")
    import matplotlib as mpl

    mpl.use("Agg")
    mpl.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False})
    import matplotlib.pyplot as plt

    case = next(one for one in generate_cases() if one.name == CASE)
    split, study, report = diagnose_example(case)
    out.mkdir(parents=True, exist_ok=True)
    figures = {
        "1-split": lambda axes: draw_split(axes, split),
        "2-residuals": lambda axes: draw_residuals(axes, study),
        "3-signatures": lambda axes: draw_signatures(axes, study),
        "4-evidence": lambda axes: draw_evidence(axes, study),
        "5-agreement": lambda axes: draw_agreement(axes, study, report),
        "6-closure": lambda axes: draw_closure(axes, study, report),
    }
    for name, draw in figures.items():
        figure, axes = plt.subplots(figsize=SIZE, layout="constrained")
        draw(axes)
        figure.savefig(out / f"{name}.png", dpi=140, metadata={"Software": None})
        plt.close(figure)
    print(f"{report.verdict}: {', '.join(report.effects)}; closed {report.gap.closure.closed:.3f}; figures in {out}")


def diagnose_example(case: GapCase) -> tuple[ShotSplit, Study, DiagnosisReport]:
    """Simulate the example and diagnose it; the study is that of the report."""
    drawn = case.kind.draw_experiment(SEED, case.shots, case.fps)
    with tempfile.TemporaryDirectory() as folder:
        read = play_case(case, drawn, Path(folder) / "case")
    scene = build_gap_scene(read)
    split = split_shots(read.recordings)
    study = run_study(scene, split, np.random.default_rng(0), ignore_progress)
    return split, study, diagnose(scene, read.recordings)


def draw_split(axes: Any, split: ShotSplit) -> None:
    uses = (
        (split.fitting, AFTER, "fitting"),
        (split.selection, "#1565c0", "selection"),
        (split.holdout, GREY, "hold-out"),
    )
    for recordings, colour, label in uses:
        for k, one in enumerate(recordings):
            path = one.positions[:, 0]
            axes.plot(path[:, 0], path[:, -1], ".", ms=2, color=colour, label=label if k == 0 else None)
    axes.set(xlabel="along, m", ylabel="height, m")
    axes.legend(frameon=False, markerscale=4)


def draw_residuals(axes: Any, study: Study) -> None:
    for fitted, colour, label in (
        (study.base, BEFORE, "gravity alone"),
        (study.full, AFTER, "with the named effects"),
    ):
        for k, (segment, start) in enumerate(zip(fitted.segments, fitted.starts, strict=True)):
            path = study.problem.scene.predict_positions(segment, start, fitted.shared, fitted.forms)
            left = 1000 * (segment.positions - path)[:, 0, -1]
            axes.plot(segment.t - segment.t[0], left, lw=1, color=colour, label=label if k == 0 else None)
    axes.set(xlabel="time since the start of the flight, s", ylabel="height observed\nminus fitted, mm")
    axes.legend(frameon=False, ncols=2, loc="lower left")


def draw_signatures(axes: Any, study: Study) -> None:
    signatures = compute_hypothesis_signatures(study.search, study.search.base)
    names = study.problem.candidates
    gains = np.array([max(signatures.gain(study.problem.mask((name,))), 1.0) for name in names])
    order = np.argsort(gains)
    axes.barh([names[k] for k in order], gains[order], color=[_pick_colour(names[k], study) for k in order])
    axes.set(xscale="log", xlabel="misfit that the effect would explain: predicted gain in chi2")


def draw_evidence(axes: Any, study: Study) -> None:
    search = study.search
    ranked = sorted(search.hypotheses.values(), key=search.log_evidence)[-8:]
    best = search.log_evidence(ranked[-1])
    labels = [" + ".join(sorted(one.names)) or "simulator alone" for one in ranked]
    behind = [best - search.log_evidence(one) for one in ranked]
    axes.barh(labels, [max(one, 0.3) for one in behind], color=[AFTER if one == 0 else GREY for one in behind])
    axes.set(xscale="log", xlabel="log evidence behind the best hypothesis")


def draw_agreement(axes: Any, study: Study, report: DiagnosisReport) -> None:
    """Draw the strength of the first named effect from each shot alone, and from all."""
    names = [prior.name for prior in study.problem.priors]
    name, free = f"{report.effects[0]}.", study.full.free
    place = next(k for k, one in enumerate(names) if one.startswith(name) and free[k])
    here = int(np.flatnonzero(np.flatnonzero(free) == place)[0])
    information = get_shot_information(study.search, study.best)
    values, sigmas = [], []
    for k in range(len(information.shots)):
        matrix = information.information[k][np.ix_(free, free)]
        step = np.linalg.pinv(matrix) @ information.score[k][free]
        values.append(study.full.shared[place] + step[here])
        sigmas.append(float(np.sqrt(np.linalg.pinv(matrix)[here, here])))
    prior = study.problem.priors[place]
    axes.errorbar(
        information.shots, values, yerr=2 * np.array(sigmas), fmt="o", ms=4, color=GREY, label="each shot alone"
    )
    joint, sigma = study.full.shared[place], study.full.shooting.sigma[here]
    axes.axhspan(joint - 2 * sigma, joint + 2 * sigma, color=AFTER, alpha=0.4, lw=0, label="all shots")
    axes.set(xlabel="shot", ylabel=f"{prior.name}, {prior.unit}", xticks=information.shots)
    axes.legend(frameon=False)


def draw_closure(axes: Any, study: Study, report: DiagnosisReport) -> None:
    gap = report.gap
    for paths, colour, label in ((gap.before, BEFORE, "gravity alone"), (gap.after, AFTER, "with the named effects")):
        t, rms = compute_error_growth(gap, paths)
        axes.plot(t, 1000 * rms, "o-", ms=3, color=colour, label=label)
    axes.axhline(gap.closure.floor * 1000, color=GREY, ls="--", label="floor: noise alone, all times")
    axes.set(xlabel="time ahead of the last observation that was used, s", ylabel="error, mm", yscale="log")
    axes.legend(frameon=False)


def _pick_colour(name: str, study: Study) -> str:
    return AFTER if name in study.best.names else GREY


if __name__ == "__main__":
    main()
