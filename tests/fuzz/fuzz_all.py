"""Damaged inputs through every reader, and a table of what came of them.

    python tests/fuzz/fuzz_all.py [--cases 10000] [--seed 1]

Readers run in a child whose memory is bounded; where one hangs in C or dies, it is counted and the
next child goes on after it.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import select
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import readers

BYTES = 1 << 30
PATIENCE = 15.0  # until a child that says nothing is ended [s]
COLUMNS = ("cases", "read", "refused", "traceback", "over 5 s", "over 1 GB", "crash", "left")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", help="one reader alone")
    options = parser.parse_args()
    started = time.perf_counter()
    table = fuzz(options.cases, options.seed, options.only)
    print("\n".join(lines(table)))
    print(f"{time.perf_counter() - started:.0f} s")
    return 1 if faults(table) else 0


def fuzz(cases: int, seed: int, only: str | None = None) -> dict[str, Counter[str]]:
    """Return the counts of each reader; what is wrong is told on stderr."""
    every = {k: r for k, r in readers.readers().items() if only in (None, k)}
    each = -(-cases // len(every))
    table = {}
    for name, reader in every.items():
        count: Counter[str] = Counter(cases=each)
        at = 0
        while at < each:
            at = _child(name, reader, (seed, at, each), count)
        table[name] = count
    return table


def case(name: str, reader: readers.Reader, seed: int, number: int) -> bytes:
    """The bytes of one case, the same each time."""
    return reader.make(random.Random(f"{name} {seed} {number}"))


def lines(table: dict[str, Counter[str]]) -> list[str]:
    rows = [f"{'input':18}" + "".join(f"{name:>11}" for name in COLUMNS)]
    whole: Counter[str] = sum(table.values(), Counter())
    for name, count in {**table, "all": whole}.items():
        rows.append(f"{name:18}" + "".join(f"{count[column]:11,}" for column in COLUMNS))
    return rows


def faults(table: dict[str, Counter[str]]) -> int:
    return sum(count[name] for count in table.values() for name in COLUMNS[3:])


def _child(
    name: str, reader: readers.Reader, span: tuple[int, int, int], count: Counter[str]
) -> int:
    """Run cases in a child until it ends; return the case to go on with."""
    seed, at, end = span
    back, forth = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(back)
        _work(name, reader, span, forth)
    os.close(forth)
    rest = b""
    while True:
        ready, _, _ = select.select([back], [], [], PATIENCE)
        said = os.read(back, 1 << 16) if ready else b""
        if not said:
            break
        *whole, rest = (rest + said).split(b"\n")
        for line in whole:
            _count(line.decode("utf-8", "replace"), name, seed, at, count)
            at += 1
    if at < end:
        os.kill(child, 9)
        _count("crash" if ready else "over 5 s", name, seed, at, count)
        at += 1
    os.close(back)
    os.waitpid(child, 0)
    return at


def _count(verdict: str, name: str, seed: int, number: int, count: Counter[str]) -> None:
    kind = verdict.partition(":")[0]
    count[kind] += 1
    if kind not in ("read", "refused"):
        sys.stderr.write(f"{name}, seed {seed}, case {number}: {verdict}\n")


def _work(name: str, reader: readers.Reader, span: tuple[int, int, int], forth: int) -> None:
    seed, at, end = span
    pages = int(Path("/proc/self/statm").read_text("utf-8").split()[0])
    most = pages * resource.getpagesize() + BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    os.dup2(quiet, 2)
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        for number in range(at, end):
            try:
                verdict = readers.judged(reader, case(name, reader, seed, number), Path(folder))
            except AssertionError as error:
                verdict = str(error)
            os.write(forth, " ".join(verdict.split()).encode("utf-8", "replace") + b"\n")
        os.chdir("/")
    os._exit(0)


if __name__ == "__main__":
    sys.exit(main())
