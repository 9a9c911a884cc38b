import xml.etree.ElementTree as ET
from dataclasses import replace

from minitouch_bench.reporting.charts import Chart, Dot, Line, Plot, name_axis, value_axis
from minitouch_bench.reporting.svg import draw_plot

HOSTILE = '</svg><script>alert(1)</script> & "x" 触覚 🤖'


def rows_plot(name="a"):
    marks = (Line(((0.2, 0), (0.9, 0)), "series-0"), Dot(0.5, 0, "series-0"))
    chart = Chart(value_axis("Success", 1.0), name_axis([name]), marks, 30)
    return Plot("Pushing", "success", (chart,))


def test_a_drawing_is_well_formed_and_holds_no_style():
    drawing = draw_plot(rows_plot())
    root = ET.fromstring(drawing)
    assert (root.get("role"), root.get("aria-label")) == ("img", "success")
    assert not [element for element in root.iter() if element.get("style")]
    assert "series-0" in drawing
    assert drawing == draw_plot(rows_plot())


def test_a_hostile_name_is_only_text():
    plot = rows_plot(HOSTILE)
    drawing = draw_plot(replace(plot, description=HOSTILE))
    assert "<script" not in drawing
    assert HOSTILE in [element.text for element in ET.fromstring(drawing).iter()]
