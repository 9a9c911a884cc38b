"""Write the tables of the stored submissions as the code writes them today: ``make tables``."""

from pathlib import Path

from minitouch_bench.files import RUN_FILE
from minitouch_bench.leaderboard.packing import tidy

SUBMISSIONS = Path("submissions")


def main() -> None:
    for run in sorted(SUBMISSIONS.glob(f"*/seed-*/*/{RUN_FILE}")):
        tidy(run.parent)


if __name__ == "__main__":
    main()
