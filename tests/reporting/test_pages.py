from minitouch_bench.reporting.pages import image_uri
from minitouch_bench.reporting.report import build_report, report_card


def test_cards_show_the_verdict_and_the_paper(hac):
    report = build_report([hac])
    cards = [report_card(report, task) for task in report.tasks]
    assert [card.title for card in cards] == ["Pushing", "Opening", "Pick-up", "Playing"]
    pushing, playing = cards[0], cards[-1]
    assert pushing.paper == "HaC in the paper: 0.733"
    assert pushing.values[0].cell.gauge.mark == 73.3
    assert playing.metric == "Touch share, share of control steps"
    assert playing.paper == ""


def test_a_missing_picture_is_left_out(tmp_path):
    assert image_uri("pushing", tmp_path) == ""
    (tmp_path / "pushing.png").write_bytes(b"\x89PNG")
    assert image_uri("pushing", tmp_path) == "data:image/png;base64,iVBORw=="
