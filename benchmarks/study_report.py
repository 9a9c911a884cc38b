"""Write the report of the stored study, ``docs/studies/table4``, from its finished trainings."""

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

from minitouch_bench.documents import write_json
from minitouch_bench.files import RUN_FILE, write_file
from minitouch_bench.processes import run_in_workers
from minitouch_bench.workflows import ignore
from minitouch_bench.workflows.study_config import STUDY_FILE, read_study
from minitouch_bench.workflows.studying import report_study

STUDY = Path(__file__).parents[1] / "docs" / "studies" / "table4"


def write_report(directory: Path) -> None:
    """Write settings and report into an empty directory, beside links to what is finished."""
    config = read_study(STUDY.with_suffix(".toml"))
    for training in config.trainings():
        if any((STUDY / training.name).glob(f"*/{RUN_FILE}")):
            (directory / training.name).symlink_to(STUDY / training.name)
    write_file(directory / STUDY_FILE, write_json(config))
    report_study(config, directory, ignore)


def main() -> None:
    """Write the report into the study's directory."""
    with TemporaryDirectory() as folder:
        directory = Path(folder) / STUDY.name
        directory.mkdir()
        # In a worker the sums have the same last bits on every processor.
        list(run_in_workers(write_report, [directory], 1, name=str))
        for path in directory.iterdir():
            if path.is_symlink() or path.suffix == ".html":
                continue
            if path.is_dir():
                shutil.copytree(path, STUDY / path.name, dirs_exist_ok=True)
            else:
                shutil.copy(path, STUDY)


if __name__ == "__main__":
    main()
