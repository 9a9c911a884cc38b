"""Write the reports of the stored studies, ``docs/studies``, from their finished trainings."""

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

from minitouch_bench.documents import write_json
from minitouch_bench.files import RUN_FILE, write_file
from minitouch_bench.processes import run_in_workers
from minitouch_bench.workflows import ignore
from minitouch_bench.workflows.study_config import STUDY_FILE, read_study
from minitouch_bench.workflows.studying import report_study

STUDIES = Path(__file__).parents[1] / "docs" / "studies"


def write_report(directory: Path) -> None:
    """Write settings and report into an empty directory, beside links to what is finished.

    The directory has the name of the study.
    """
    stored = STUDIES / directory.name
    config = read_study(stored.with_suffix(".toml"))
    for training in config.trainings():
        if any((stored / training.name).glob(f"*/{RUN_FILE}")):
            (directory / training.name).symlink_to(stored / training.name)
    write_file(directory / STUDY_FILE, write_json(config))
    report_study(config, directory, ignore)


def main() -> None:
    """Write each report into its study's directory."""
    for file in sorted(STUDIES.glob("*.toml")):
        with TemporaryDirectory() as folder:
            directory = Path(folder) / file.stem
            directory.mkdir()
            # In a worker the sums have the same last bits on every processor.
            list(run_in_workers(write_report, [directory], 1, name=str))
            for path in directory.iterdir():
                if path.is_symlink() or path.suffix == ".html":
                    continue
                target = STUDIES / file.stem / path.name
                if path.is_dir():
                    shutil.copytree(path, target, dirs_exist_ok=True)
                else:
                    shutil.copy(path, target)


if __name__ == "__main__":
    main()
