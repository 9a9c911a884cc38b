import xml.etree.ElementTree as ET
from dataclasses import replace

import pytest

from minitouch_bench.reporting.charts import Chart, Dot, Line, Plot, name_axis, share_axis
from minitouch_bench.reporting.svg import draw_plot, draw_share_bar

HOSTILE = '</svg><script>alert(1)</script> & "x" 触覚 🤖'


def rows_plot(name="a"):
    marks = (Line(((0.2, 0), (0.9, 0)), "series-0"), Dot(0.5, 0, "series-0"))
    return Plot("Pushing", "success", (Chart(share_axis("Success"), name_axis([name]), marks, 30),))


def test_a_drawing_is_well_formed_and_holds_no_style():
    drawing = draw_plot(rows_plot())
    root = ET.fromstring(drawing)
    assert (root.get("role"), root.get("aria-label")) == ("img", "success")
    assert not [element for element in root.iter() if element.get("style")]
    assert "series-0" in drawing
    assert drawing == draw_plot(rows_plot())


def test_a_hostile_name_is_only_text():
    plot = rows_plot(HOSTILE)
    marks = (*plot.charts[0].marks, Dot(0, 0, "muted", label=HOSTILE, title=HOSTILE, link='"x'))
    plot = replace(plot, description=HOSTILE, charts=(replace(plot.charts[0], marks=marks),))
    drawing = draw_plot(plot)
    assert "<script" not in drawing
    assert HOSTILE in [element.text for element in ET.fromstring(drawing).iter()]


def test_a_share_bar_is_as_wide_as_its_place():
    drawing = draw_share_bar([("success", "won", 3), ("limit", "lost", 1)], "Pushing")
    root = ET.fromstring(drawing)
    widths = [float(e.get("width").rstrip("%")) for e in root.iter() if e.tag.endswith("rect")]
    assert widths == pytest.approx([75, 25], abs=0.5)
    assert "won: 3 of 4" in drawing
