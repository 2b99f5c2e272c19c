"""Check every contact of a result: how far it drifts and how far it is off the ground.

python scripts/validate_contacts.py out/walk --drift 1 --gap 2
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from mjmotion import read_results
from mjmotion.validation import validate


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path, help="folder that mjmotion adapt wrote")
    parser.add_argument("--drift", type=float, default=1.0, help="greatest drift [mm]")
    parser.add_argument("--gap", type=float, default=2.0, help="greatest gap on solid ground [mm]")
    parser.add_argument("--gap-hfield", type=float, default=10.0, help="on heightfields [mm]")
    args = parser.parse_args()

    results = read_results(args.folder)
    validation = validate(results.source, results.motion, results.contacts)
    bad = 0
    print(f"{'site':14} {'frames':>11} {'drift':>9} {'gap':>9}   on")
    for contact in validation.per_contact:
        limit = args.gap_hfield if contact["ground_kind"] == "hfield" else args.gap
        broken = contact["drift_mm"] > args.drift or contact["gap_mm"] > limit
        bad += broken
        frames = f"{contact['start']}-{contact['end']}"
        print(
            f"{contact['site']:14} {frames:>11} {contact['drift_mm']:6.2f} mm"
            f" {contact['gap_mm']:6.2f} mm   {contact['ground']}{'   <- broken' if broken else ''}"
        )
    print(f"{len(validation.per_contact)} contacts, {bad} broken")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
