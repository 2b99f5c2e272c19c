"""Thousands at once: all clips on all scenes with all characters, resumed, on any number of cores.

    batch = make_batch(["recordings/*.bvh"], terrains=100)
    with Processes(2) as executor:
        counts = run_batch(batch, open_storage("out/all"), executor)

A *job* is one clip on one scene with one character. Each is one call of :func:`mjmotion.adapt`, and
fails alone. What is done is known by a hash of what it was made from, and is not done again. Where
jobs run is an :class:`~mjmotion.apps.batch.executors.Executor`: processes of this machine, or the
workers of a Dask cluster; what they do is the same function.
"""

from mjmotion.apps.batch.executors import Executor, Processes
from mjmotion.apps.batch.inputs import make_batch
from mjmotion.apps.batch.jobs import Batch, Job, Settings, Source
from mjmotion.apps.batch.run import Counts, run_batch
from mjmotion.apps.batch.storage import open_storage

__all__ = [
    "Batch",
    "Counts",
    "Executor",
    "Job",
    "Processes",
    "Settings",
    "Source",
    "make_batch",
    "open_storage",
    "run_batch",
]
