"""What can go wrong with a user's material; wrong arguments of a function raise ValueError instead.

TruerollError
├── ClipError            video/: the file is not a clip that can be used
├── TableNotFound        video/: no table in the picture, or it cannot be trusted
├── ModelError           detectors/: an ONNX file is not a ball detector
├── TrackError           models/: too little was seen to follow balls
└── OptionError          pipeline/: an option that makes no sense for this clip
"""

from __future__ import annotations


class TruerollError(Exception):
    """One sentence: what was wanted, what came, what to do. Shown without a traceback."""


class ClipError(TruerollError):
    """The file is not a clip that can be used."""


class TableNotFound(TruerollError):
    """No table in the picture, or none that can be trusted."""


class ModelError(TruerollError):
    """An ONNX file is not a ball detector."""


class TrackError(TruerollError):
    """Too little was seen to follow balls."""


class OptionError(TruerollError):
    """An option that makes no sense for this clip."""
