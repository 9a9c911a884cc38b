"""Record the bits of the golden episodes, after a task's revision was raised.

``python -m benchmarks.golden`` writes them as this machine computes them.
"""

import json
from pathlib import Path

from minitouch_bench.protocol.minitouch import TASK_NAMES
from minitouch_bench.verification import doctor

PLACE = Path(doctor.__file__).with_name(doctor.GOLDEN_FILE)


def main() -> None:
    content = {task: doctor.golden_bits(task) for task in TASK_NAMES}
    PLACE.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
