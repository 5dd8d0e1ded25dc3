"""Hold every formula of fluids, containers and lines against numbers that the package did not produce.

    python experiments/verify_physics.py --out results/verify_physics [--data FOLDER] [--docs]

Writes results.json (all rows) and physics.md (the page) to the folder; with --docs the page is also written to
docs/physics.md, without the rows that need files. --data is a folder in which, or below which, such files are:
`effective_bulk_modulus.json` and `darcy_friction_factors.json`. Exits with 1 when a number misses its tolerance or
a formula has no row.
"""

import argparse
import json
import sys
from pathlib import Path

import jax
import verify_fluids
import verify_gas
import verify_lines
import verify_published
import verify_walls
import verify_waves
from verify_data import FILES, data_rows
from verify_page import page, summary, uncovered
from verify_published import differences
from verify_rows import Row

from jaxlines.edge.writing import plain, write_whole

PARTS = (verify_walls, verify_gas, verify_fluids, verify_published, verify_lines, verify_waves)
DOCS = Path(__file__).parents[1] / "docs" / "physics.md"


def all_rows() -> dict[str, list[Row]]:
    """Topic -> rows, in float64."""
    with jax.enable_x64(True):
        return {topic: rows() for part in PARTS for topic, rows in part.TOPICS.items()}


def finding(rows: list[Row], forgotten: list[str], skipped: list[str]) -> str:
    """The result in one line."""
    parts = [summary(rows)]
    missed = [f"{row.formula} ({row.case})" for row in rows if not row.passes]
    parts += [f"MISSED: {', '.join(missed)}"] * bool(missed)
    parts += [f"WITHOUT A ROW: {', '.join(forgotten)}"] * bool(forgotten)
    parts += [f"skipped for want of files: {', '.join(skipped)}"] * bool(skipped)
    return "; ".join(parts)


def main(arguments: list[str] | None = None) -> int:
    """Evaluate, write, judge."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for results.json and physics.md")
    parser.add_argument("--data", type=Path, help=f"folder with {' and '.join(FILES)}")
    parser.add_argument("--docs", action="store_true", help="also write docs/physics.md")
    args = parser.parse_args(arguments)
    args.out.mkdir(parents=True, exist_ok=True)
    own, (read, skipped) = all_rows(), data_rows(args.data)
    topics, found = own | read, differences()
    rows = [row for group in topics.values() for row in group]
    forgotten = uncovered(rows)
    result = {
        "rows": [{"topic": topic} | row.to_dict() for topic, group in topics.items() for row in group],
        "published_moduli": [case._asdict() for case in found],
        "without_a_row": forgotten,
        "skipped": skipped,
        "finding": finding(rows, forgotten, skipped),
    }
    write_whole(args.out / "results.json", json.dumps(plain(result), indent=1) + "\n")
    write_whole(args.out / "physics.md", page(topics, found, skipped))
    if args.docs:
        write_whole(DOCS, page(own, found, list(FILES)))
    print(result["finding"])
    return 1 if forgotten or not all(row.passes for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
