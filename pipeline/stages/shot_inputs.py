"""Inputs of the stages that show a shot: the shot, and the contact models of whole shots where they were asked for."""

from __future__ import annotations

from models.core.fit_result import Fit
from models.core.options import FitOptions
from pipeline.engine.stage import Inputs
from pipeline.io.run_views import view_run


def list_view_inputs(options: FitOptions) -> tuple[str, ...]:
    """List the stages that `view_inputs` needs.

    Args:
        options: Options of the explanation.

    Returns:
        Names of stages.
    """
    return ("explain", "laws") if options.laws else ("explain",)


def view_inputs(inputs: Inputs, options: FitOptions) -> Fit:
    """Evaluate the views of a shot.

    Args:
        inputs: Inputs of a stage, with those of `list_view_inputs`.
        options: Options of the explanation.

    Returns:
        The views.
    """
    return view_run(inputs["explain"], inputs.get("laws"), options.profile)
