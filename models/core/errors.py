"""Errors of a user's material. Wrong arguments of a function raise ValueError instead.

TruerollError
├── ClipError            video/: the file is not a usable clip
├── TableNotFound        video/: the image shows no table, or none that was found reliably
├── ModelError           detectors/: an ONNX file is not a ball detector
├── TrackError           models/: too few detections to track balls
└── OptionError          pipeline/: an option that is wrong or does not suit the clip
"""

from __future__ import annotations


class TruerollError(Exception):
    """Base of all errors of a user's material. One sentence: what was expected, what was found, what to do.

    The command line prints it without a traceback.
    """


class ClipError(TruerollError):
    """The file is not a usable clip."""


class TableNotFound(TruerollError):
    """The image shows no table, or none that was found reliably."""


class ModelError(TruerollError):
    """An ONNX file is not a ball detector."""


class TrackError(TruerollError):
    """There are too few detections to track balls."""


# Why a clip of an empty table is refused, before and while its balls are tracked.
NO_BALLS = "no ball is detected on the table; film it with balls on it, or give --corners and --ball-radius"
# Why nothing can be said of the stroke of a clip in which all balls rest.
NO_STROKE = "no ball moves in this clip, so there is no stroke; choose a clip with a strike"


class OptionError(TruerollError):
    """An option is wrong or does not suit the clip."""
