"""Errors of a user's material. Wrong arguments of a function raise ValueError instead.

TruerollError
├── ClipError            video/: the file is not a usable clip
├── TableNotFound        video/: the image shows no table, or none that was found reliably
├── ModelError           detectors/: an ONNX file is not a ball detector
├── TrackError           models/: too few detections to track balls
└── OptionError          pipeline/: an option that is wrong or does not suit the clip
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

# What else the user of a command can do, by the names that errors have for it.
COMMAND_REMEDIES = {
    "corners": "give the corners of the playing surface with --corners x,y,x,y,x,y,x,y",
    "court corners": "give the corners of the court with --corners x,y,x,y,x,y,x,y",
    "balls": "give --corners and --ball-radius",
    "radius": "give --ball-radius in metres, such as 0.028575",
    "rate": "give the right number with --fps",
    "pixels": "if the pixels are not square, state their shape with --pixel-aspect",
}


class TruerollError(Exception):
    """Base of all errors of a user's material. One sentence: what was expected, what was found, what to do.

    The command line prints it without a traceback. Where the sentence names an option, each front end has words of its
    own for it; `str` has those of the command line.
    """

    def __init__(self, sentence: str, *, option: str = "", remedy: str = "") -> None:
        """Make an error.

        Args:
            sentence: The sentence, without the parts below.
            option: Option that begins it, such as `at`; empty for none.
            remedy: What else the user can do, a name in `COMMAND_REMEDIES`; empty for nothing.
        """
        super().__init__(sentence)
        self.option, self.remedy = option, remedy

    def __str__(self) -> str:
        return self.word(lambda option: f"--{option}", COMMAND_REMEDIES)

    def word(self, name_option: Callable[[str], str], remedies: Mapping[str, str]) -> str:
        """Return the sentence in the words of a front end.

        Args:
            name_option: Names an option.
            remedies: What else can be done there, by name; one that is missing cannot.
        """
        sentence = f"{name_option(self.option)} {self.args[0]}" if self.option else str(self.args[0])
        remedy = remedies.get(self.remedy, "")
        joint = ", or " if ";" in sentence else "; "
        return f"{sentence}{joint}{remedy}" if remedy else sentence


class ClipError(TruerollError):
    """The file is not a usable clip."""


class TableNotFound(TruerollError):
    """The image shows no table, or none that was found reliably."""


class ModelError(TruerollError):
    """An ONNX file is not a ball detector."""


class TrackError(TruerollError):
    """There are too few detections to track balls."""


# Why a clip of an empty table is refused, before and while its balls are tracked.
NO_BALLS = "no ball is detected on the table; film it with balls on it"
# Why nothing can be said of the stroke of a clip in which all balls rest.
NO_STROKE = "no ball moves in this clip, so there is no stroke; choose a clip with a strike"


class OptionError(TruerollError):
    """An option is wrong or does not suit the clip."""
