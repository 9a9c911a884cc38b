import xml.etree.ElementTree as ET

from minitouch_bench.reporting.charts import (
    Chart,
    Line,
    Plot,
    Spots,
    draw_plot,
    name_axis,
    value_axis,
)

HOSTILE = '</svg><script>alert(1)</script> & "x" 触覚 🤖'


def test_a_hostile_name_is_only_text():
    marks = (Line(((0.2, 0), (0.9, 0)), "series-0"), Spots(((0.5, 0),), "series-0", 8))
    chart = Chart(value_axis("Success", 1.0), name_axis([HOSTILE]), marks, 30, "one" * 90)
    drawing = draw_plot(Plot("Pushing", HOSTILE, (chart,)))
    assert "<script" not in drawing
    texts = [element.text for element in ET.fromstring(drawing).iter() if element.text]
    assert HOSTILE in texts
    assert max(map(len, texts)) <= max(40, len(HOSTILE))
