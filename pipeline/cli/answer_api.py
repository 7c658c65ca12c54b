"""The questions that can be asked from Python: the functions of the commands that return an answer.

A new question is a file in `pipeline/cli/commands/`, its name in `COMMAND_NAMES` there, and its export here and in
`trueroll/__init__.py`; see docs/how-to/extend.md.
"""

from pipeline.cli.commands.call_command import call as call
from pipeline.cli.commands.certify_command import certify as certify
from pipeline.cli.commands.compare_command import compare as compare
from pipeline.cli.commands.convert_command import convert as convert
from pipeline.cli.commands.fit_table_command import fit_table as fit_table
from pipeline.cli.commands.predict_command import predict as predict
from pipeline.cli.commands.put_back_command import put_back as put_back
from pipeline.cli.commands.what_if_command import what_if as what_if
