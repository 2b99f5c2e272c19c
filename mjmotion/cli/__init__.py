"""The commands, one a file: ``HELP``, ``EXAMPLE``, ``arguments(parser)`` and ``run(args)``.

A command's module imports only ``argparse`` and :mod:`mjmotion.cli.arguments` when it is
loaded, so that ``--help`` answers at once; ``run`` imports what it needs. ``COMMANDS`` in
:mod:`mjmotion.cli.main` lists them.

Results go to stdout, progress and warnings to stderr.
"""
