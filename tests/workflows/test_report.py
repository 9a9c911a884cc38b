"""The command ``report`` in Python."""

from minitouch_bench.workflows.report import report
from tests.reporting.synthetic import make_run, write


def test_the_videos_of_a_run_are_in_its_report_however_it_is_named(tmp_path):
    write(make_run("a", tasks=("pushing",), episodes=2, exploration=False), tmp_path)
    (tmp_path / "videos").mkdir()
    (tmp_path / "videos" / "pushing-1.mp4").write_bytes(b"a video")
    for path in (tmp_path, tmp_path / "run.json"):
        report([path])
        assert "videos/pushing-1.mp4" in (tmp_path / "report.html").read_text()
