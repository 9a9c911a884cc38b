"""``leaderboard.json``; its schema is published as ``docs/leaderboard.schema.json``."""

import json
from dataclasses import asdict
from typing import Any

from minitouch_bench.leaderboard.board import Board, BoardRow
from minitouch_bench.leaderboard.scores import OVERALL
from minitouch_bench.leaderboard.validation import Verdict
from minitouch_bench.metrics.definitions import unit_of
from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.records import Estimate
from minitouch_bench.rendering.escaping import printable
from minitouch_bench.reporting.paper import PAPER_METHODS, paper_values

FORMAT = "minitouch-leaderboard"
VERSION = 1


def board_json(board: Board) -> str:
    """Write a board as JSON; NaN and infinity are refused."""
    document = {
        "format": FORMAT,
        "version": VERSION,
        "protocol": board.protocol,
        "protocol_digest": board.protocol_digest,
        "ranked": [_row(row) for row in board.ranked],
        "calibration": [_row(row) for row in board.calibration],
        "missing_calibration": list(board.missing_calibration),
        "paper": [
            {
                "method": method,
                "figures": [
                    {
                        "task": task,
                        "metric": metric,
                        "value": float(printed.text),
                        "is_our_unit": printed.is_our_unit,
                    }
                    for (task, metric), printed in paper_values(method).items()
                ],
            }
            for method in PAPER_METHODS
        ],
        "other_protocol": [_left_out(verdict) for verdict in board.apart],
        "refused": [_left_out(verdict) for verdict in board.refused],
    }
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _row(row: BoardRow) -> dict[str, Any]:
    entry, about = row.entry, row.entry.about
    return {
        **asdict(about),
        "proof": entry.level.value,
        "rerun_episodes": entry.proof.rerun_episodes if entry.proof else 0,
        "same_episodes_as": list(row.twins),
        "training_seeds": [seed.seed.seed for seed in entry.seeds],
        "runs": {run.place: run.digest for seed in entry.seeds for run in seed.runs.values()},
        "ranks": {task: asdict(rank) for task, rank in row.ranks.items()},
        "figures": {
            place: {
                metric: _estimate(
                    found, "share of episodes" if place == OVERALL else unit_of(metric, place)
                )
                for (task, metric), found in row.figures.items()
                if task == place
            }
            for place in (OVERALL, *TASK_NAMES)
        },
        "novel_shapes": {
            task: {
                "held_out": _plain(gap.held_out),
                "train": _plain(gap.train),
                "gap": _plain(gap.difference),
            }
            for task, gap in row.gaps.items()
        },
        "endings": {task: dict(counts) for task, counts in row.endings.items()},
    }


def _estimate(found: Estimate, unit: str) -> dict[str, Any]:
    return {**_plain(found), "unit": unit}


def _plain(found: Estimate) -> dict[str, Any]:
    return asdict(found)


def _left_out(verdict: Verdict) -> dict[str, Any]:
    return {
        "name": printable(verdict.directory.name),
        "reasons": [str(fault) for fault in verdict.faults],
    }
