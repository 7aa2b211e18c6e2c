"""The command line: ``pasdedeux VERB``. Files in, files out; see :mod:`bridge.cli.main`."""

from bridge.cli.main import main as main
