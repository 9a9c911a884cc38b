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
    assert all(card.image.startswith("data:image/png;base64,") for card in cards)
