"""The static site."""

from pathlib import Path

from minitouch_bench.leaderboard.board import Board


def write_site(board: Board, output: Path) -> None:
    """Write the site."""
