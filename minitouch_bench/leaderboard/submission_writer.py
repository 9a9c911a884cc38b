"""Write ``submission.toml``, in a fixed order and form."""

import json
from collections.abc import Sequence

from minitouch_bench.leaderboard.submission import (
    FORMAT,
    VERSION,
    CheckpointFile,
    Submission,
    TrainingSeed,
)


def submission_text(submission: Submission) -> str:
    """Write a submission as TOML; the texts must have passed ``texts``."""
    about = submission.about
    lines = [
        f"format = {_string(FORMAT)}",
        f"version = {VERSION}",
        f"name = {_string(about.name)}",
        f"method = {_string(about.method)}",
        f"authors = {_list(about.authors)}",
        f"paper = {_string(about.paper)}",
        f"code = {_string(about.code)}",
        f"licence = {_string(about.licence)}",
        f"training_steps = {about.training_steps}",
        f"modalities = {_list(about.modalities)}",
        f"notes = {_string(about.notes)}",
    ]
    for seed in sorted(submission.seeds, key=lambda seed: seed.seed):
        lines += _seed(seed)
    return "\n".join(lines) + "\n"


def _seed(seed: TrainingSeed) -> list[str]:
    lines = ["", "[[seeds]]", f"seed = {seed.seed}", "", "[seeds.runs]"]
    lines += [f"{suite} = {_string(path)}" for suite, path in seed.runs.items()]
    for file in seed.checkpoints:
        lines += _checkpoint(file)
    return lines


def _checkpoint(file: CheckpointFile) -> list[str]:
    return [
        "",
        "[[seeds.checkpoints]]",
        f"role = {_string(file.role.value)}",
        f"task = {_string(file.task)}",
        f"file = {_string(file.file)}",
        f"sha256 = {_string(file.sha256)}",
        f"path = {_string(file.path)}",
    ]


def _string(text: str) -> str:
    """Write a basic string: JSON's escapes are TOML's, and DEL needs one as well."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _list(texts: Sequence[str]) -> str:
    return f"[{', '.join(map(_string, texts))}]"
