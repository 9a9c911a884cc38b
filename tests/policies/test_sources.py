import hashlib
from pathlib import Path

import pytest

from minitouch_bench.episode import Role
from minitouch_bench.errors import PolicyLoadError
from minitouch_bench.policies.sources import parse_source


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "pushing.onnx").write_bytes(b"one")
    (tmp_path / "pick-up.pt").write_bytes(b"two")
    (tmp_path / "README.md").write_text("not a policy")
    return tmp_path


@pytest.mark.parametrize(
    ("text", "kind", "notes"),
    [
        ("zero", "zero", ()),
        ("scripted", "scripted", ("reads the simulator's state",)),
        ("http://localhost:8000", "remote", ("remote",)),
        ("package.module:attribute", "factory", ()),
    ],
)
def test_what_is_no_file_has_no_digest_and_tables_say_what_it_is(text, kind, notes):
    identity = parse_source(text).identity()
    assert (identity.kind, identity.digest, identity.notes) == (kind, "", notes)


@pytest.mark.parametrize(
    ("suffix", "kind"), [(".safetensors", "native"), (".ts", "torchscript"), (".zip", "sb3")]
)
def test_a_files_suffix_names_its_format(tmp_path, suffix, kind):
    path = tmp_path / f"mine{suffix}"
    path.write_bytes(b"weights")
    identity = parse_source(str(path)).identity()
    assert (identity.name, identity.kind, identity.source) == ("mine", kind, str(path))
    assert identity.digest == hashlib.sha256(b"weights").hexdigest()


def test_a_directory_has_one_file_a_task(folder):
    source = parse_source(str(folder))
    assert source.for_task("pushing").kind == "onnx"
    assert source.for_task("pick-up").kind == "torchscript"
    with pytest.raises(PolicyLoadError, match="'opening'"):
        source.for_task("opening")


def test_a_directorys_digest_covers_names_and_contents(folder):
    before = parse_source(str(folder)).identity().digest
    (folder / "README.md").write_text("changed")
    assert parse_source(str(folder)).identity().digest == before
    (folder / "pushing.onnx").rename(folder / "playing.onnx")
    renamed = parse_source(str(folder)).identity().digest
    (folder / "playing.onnx").write_bytes(b"other")
    assert len({before, renamed, parse_source(str(folder)).identity().digest}) == 3


def test_two_files_for_one_task_are_refused(folder):
    (folder / "pushing.zip").write_bytes(b"three")
    with pytest.raises(PolicyLoadError, match=r"pushing\.onnx, pushing\.zip"):
        parse_source(str(folder))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("missing.pt", "does not exist"),
        ("nothing", "there is no policy"),
        ("http://", "address"),
        ("http://user:secret@host", "address"),
        ("http://[::1:8000", "address"),
        (f"{'x' * 300}.onnx", "cannot be read"),
    ],
)
def test_what_is_not_there_is_said(text, message):
    with pytest.raises(PolicyLoadError, match=message) as caught:
        parse_source(text)
    assert len(str(caught.value).splitlines()) <= 2


def test_unusable_files_are_refused(tmp_path):
    (tmp_path / "empty.pt").touch()
    (tmp_path / "pointer.pt").write_text("version https://git-lfs.github.com/spec/v1\n")
    (tmp_path / "weights.h5").write_bytes(b"1")
    (tmp_path / "hollow").mkdir()
    (tmp_path / "training").mkdir()
    (tmp_path / "training" / "config.toml").write_text('task = "pushing"\n')
    for name, message in (
        ("empty.pt", "is empty"),
        ("weights.h5", r"known are .*\.safetensors"),
        ("hollow", "no policies"),
        ("training", "unfinished training"),
        ("pointer.pt", "git lfs pull"),
    ):
        with pytest.raises(PolicyLoadError, match=message):
            parse_source(str(tmp_path / name))


def test_a_training_directory_is_its_policy_of_each_role(tmp_path):
    for role in Role:
        (tmp_path / f"{role}.safetensors").write_bytes(role.encode())
        source = parse_source(str(tmp_path), role=role)
        assert (source.name, source.kind) == (tmp_path.name, "native")
        assert source.target == str(tmp_path / f"{role}.safetensors")
        assert source.digest == hashlib.sha256(role.encode()).hexdigest()


def test_a_link_in_a_directory_is_not_followed(tmp_path):
    """The user named the directory: its maker could link any file of theirs."""
    (tmp_path / "secret").write_bytes(b"weights of another project")
    link = tmp_path / "policy" / "pushing.onnx"
    link.parent.mkdir(parents=True)
    link.symlink_to(tmp_path / "secret")
    with pytest.raises(PolicyLoadError, match="symbolic link"):
        parse_source(str(tmp_path / "policy"))
    assert parse_source(str(link)).digest  # the user named the link


def write_training(directory, seed, files):
    """Add a training to a submission: its checkpoints by role, each holding its own name."""
    lines = ["[[trainings]]", f"seed = {seed}"]
    for file in files:
        path = directory / "checkpoints" / f"seed-{seed}" / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(file.encode())
        digest = hashlib.sha256(file.encode()).hexdigest()
        lines += ["[[trainings.checkpoints]]", f'role = "{path.parent.name}"']
        lines += [f'task = "{path.stem}"', f'file = "{path.name}"', f'sha256 = "{digest}"']
    with (directory / "submission.toml").open("a") as toml:
        toml.write("\n".join([*lines, ""]))


def test_the_file_of_a_submission_is_read_with_care(tmp_path):
    write_training(tmp_path, 0, ["final/pushing.onnx"])
    toml = tmp_path / "submission.toml"
    toml.write_text("\ufeff" + toml.read_text())
    assert parse_source(str(tmp_path)).parts
    toml.write_text("a" + ".a" * 20_000 + " = 1\n")  # tomllib takes 1.5 GB
    with pytest.raises(PolicyLoadError):
        parse_source(str(tmp_path))


@pytest.mark.parametrize("place", ["checkpoints", "checkpoints/seed-0/final/pushing.onnx"])
def test_a_linked_directory_in_a_submission_is_not_followed(tmp_path, place):
    write_training(tmp_path, 0, ["final/pushing.onnx"])
    (tmp_path / place).rename(tmp_path / "secret")
    (tmp_path / place).symlink_to(tmp_path / "secret")
    with pytest.raises(PolicyLoadError, match=f"{place} .*symbolic link"):
        parse_source(str(tmp_path))


def test_a_role_without_a_checkpoint_is_named(tmp_path):
    (tmp_path / "final.safetensors").write_bytes(b"final")
    with pytest.raises(PolicyLoadError, match=r"no exploration\.safetensors"):
        parse_source(str(tmp_path), role=Role.EXPLORATION)
    write_training(tmp_path, 0, ["final/pushing.onnx"])
    with pytest.raises(PolicyLoadError, match="seed-0 has no exploration checkpoints"):
        parse_source(str(tmp_path), role=Role.EXPLORATION)


def test_a_submission_is_the_checkpoints_of_its_first_training(tmp_path):
    write_training(
        tmp_path, 2, ["final/pushing.onnx", "final/opening.pt", "exploration/pushing.onnx"]
    )
    write_training(tmp_path, 10, ["final/pushing.onnx"])
    source = parse_source(str(tmp_path))
    assert source.name == tmp_path.name
    first = tmp_path / "checkpoints" / "seed-2" / "final"
    assert {Path(part.target).parent for _, part in source.parts} == {first}
    assert source.digest == parse_source(str(first)).digest
    explored = parse_source(str(tmp_path), role=Role.EXPLORATION)
    assert explored.for_task("pushing").kind == "onnx"
    assert explored.name == tmp_path.name
