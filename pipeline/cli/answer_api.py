"""The questions of Python: the functions of the commands, each of which returns an answer."""

from pipeline.cli.commands.call_command import call as call
from pipeline.cli.commands.certify_command import certify as certify
from pipeline.cli.commands.compare_command import compare as compare
from pipeline.cli.commands.convert_command import convert as convert
from pipeline.cli.commands.fit_table_command import fit_table as fit_table
from pipeline.cli.commands.predict_command import predict as predict
from pipeline.cli.commands.put_back_command import put_back as put_back
from pipeline.cli.commands.what_if_command import what_if as what_if
