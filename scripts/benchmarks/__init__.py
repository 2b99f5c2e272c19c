"""The parts of ``scripts/benchmark.py``: quality, levels, speed, command line, README."""
