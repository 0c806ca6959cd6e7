import base64
import hashlib
import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from markup import Markup
from scipy.signal import lti, step

from sim2real.model import FittedEffect, JointModel, Model
from sim2real.recording import Load
from sim2real.report.identification import describe_response, identification_section, step_response
from sim2real.report.page import (
    Figure,
    Film,
    Note,
    Section,
    Table,
    Text,
    render_fragment,
    render_page,
)
from sim2real.report.quantity import change_text
from sim2real.report.series import fit_panels, series_block

EVIL = "<script>alert(1)</script>"
PROVENANCE = {
    "command": f"sim2real identify {EVIL}",
    "seed": 0,
    "versions": {"python": "3.11"},
    "inputs": {"/somewhere/steps.csv": "0123456789abcdef" * 4},
}
BACKLASH = FittedEffect("backlash", {"gap_rad": 0.03})


@pytest.fixture(scope="module")
def section(bench):
    return identification_section(bench.model, bench.fits)


@pytest.fixture(scope="module")
def html(section):
    other = Section("Recordings", "What came in.", [Note("good", "Nothing is missing.")])
    return render_page("Fish", "On the bench", [other, section], PROVENANCE)


def test_page_is_well_formed_and_has_every_part(html):
    page = Markup(html)
    text = page.text
    for part in ("Fish", "On the bench", "Identification", "Nothing is missing.", "0123456789ab"):
        assert part in text
    assert "0123456789abc" not in text and "/somewhere" not in text
    links = [value for name, value in page.attributes if name == "href"]
    assert {"#section-1", "#section-2"} <= set(links)


def test_nothing_is_loaded_from_elsewhere(html):
    page = Markup(html)
    assert "img" not in page.tags
    for name, value in page.attributes:
        if name in ("src", "href", "xlink:href", "action", "data"):
            assert value.startswith(("#", "data:")), (name, value)
    assert not re.search(r"url\((?!#)|@import", html)


def test_the_only_script_is_the_one_that_the_policy_names(html):
    data, (script,) = _scripts(html)
    assert len(data) == 3  # the fits of three joints
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = dict(Markup(html).attributes)["content"]
    assert f"script-src 'sha256-{digest}'" in policy and "unsafe-eval" not in policy
    assert "uPlot (v" in script and "fetch(" not in script and "XMLHttpRequest" not in script
    still = render_page("t", "", [Section("s", "", [Text("no plot")])], {})
    assert "<script" not in still and "script-src" not in still


def test_a_plot_has_every_sample_with_gaps(html, bench):
    (position, residual), *_ = (json.loads(text) for text in _scripts(html)[0])
    assert [curve["label"] for curve in position["curves"]] == ["command", "measured", "predicted"]
    t, measured = _numbers(position["t"]), _numbers(position["curves"][1]["y"])
    sampled = np.isin(t, bench.recording.t.astype(np.float32))
    assert sampled.sum() == bench.recording.t.size
    np.testing.assert_array_equal(
        measured[sampled], bench.recording.position[:, 0].astype(np.float32)
    )
    assert np.isnan(measured[~sampled]).all() and (~sampled).any()
    error = 1e3 * (bench.recording.position - bench.predicted)[:, 0]
    np.testing.assert_allclose(_numbers(residual["curves"][0]["y"])[sampled], error, atol=1e-4)
    held = bench.recording.t[bench.heldout]
    assert position["shaded"] == residual["shaded"] == [[held[0], held[-1]]]


def test_a_name_cannot_leave_the_data_of_a_plot(bench):
    recording = replace(bench.recording, name="</script><script>alert(1)</script>")
    panels, _ = fit_panels(recording, "j1", bench.predicted[:, 0])
    page = render_page("t", "", [Section("s", "", [series_block(panels, "")])], {})
    data, scripts = _scripts(page)
    assert len(scripts) == 1 and "alert" not in scripts[0]
    assert json.loads(data[0])[0]["recording"] == recording.name


def test_a_notebook_shows_a_figure_without_script(bench):
    panels, _ = fit_panels(bench.recording, "j1", bench.predicted[:, 0])
    shown = render_fragment([Section("s", "", [series_block(panels, "", "seen")])])
    assert "seen" in shown and "script" not in shown


def _scripts(html):
    """Data of the plots, and code."""
    data = re.findall(r'<script type="application/json" class="panels">(.*?)</script>', html)
    return data, re.findall(r"<script>(.*?)</script>", html, re.S)


def _numbers(text):
    return np.frombuffer(base64.b64decode(text), "<f4")


def test_ids_are_unique(html):
    ids = [value for name, value in Markup(html).attributes if name == "id"]
    assert len(ids) == len(set(ids))


def test_a_film_is_inside_the_page():
    film = Film(b"GIF89a and so on", EVIL, "what it shows")
    page = render_page("t", "", [Section("s", "", [film])], {})
    (source,) = re.findall(r'<img src="data:image/gif;base64,([^"]+)"', page)
    assert base64.b64decode(source) == film.gif
    assert EVIL not in page
    assert "what it shows" in page


def test_everything_is_escaped():
    blocks = [
        Text(EVIL, heading=EVIL),
        Note("warn", EVIL),
        Table((EVIL, f"a\n{EVIL}"), [(EVIL, f"1\n{EVIL}")], EVIL),
        Figure("<svg></svg>", EVIL),
    ]
    html = render_page(EVIL, EVIL, [Section(EVIL, EVIL, blocks)], PROVENANCE)
    assert "<script" not in html and html.count("&lt;script&gt;") >= 12
    Markup(html)


def test_a_ragged_table_is_refused():
    with pytest.raises(ValueError, match="row 1: 1 cells, header has 2"):
        Table(("a", "b"), [("1", "2"), ("1",)])


def test_section_has_tables_plots_sentences_and_notes(bench, section):
    parameters, errors = (block for block in section.blocks if isinstance(block, Table))
    assert parameters.rows[0] == ("j1", "kp", "2.204", "N m/rad", "2.110 to 2.298", "± 4.3 %")
    by_name = {row[:2]: row[2:] for row in parameters.rows}
    assert by_name["j2", "kp"] == ("1.80", "N m/rad", "above 1.62", "")
    assert by_name["j1", "inertia"][3] == "stated"
    assert errors.rows[0] == (
        "j1", "4.1 mrad", "4.3 mrad", "1.9 mrad", "correlated over 35 ms, 0.6 % outliers",
    )  # fmt: skip
    kinds = [type(block).__name__ for block in section.blocks]
    assert kinds == ["Table", "Table", *["Note"] * 4, *["Text", "Figure"] * 3]
    words = [b.paragraph for b in section.blocks if isinstance(b, Text)]
    assert "66 ms is latency" in words[0] and "2.3 times the noise" in words[0]


def test_units_are_those_of_each_joint():
    known = JointModel(2.0, 0.06, 0.07, 0.002, load=Load(0.002))
    unknown = JointModel(1100.0, 30.0, 0.07, 1.0, per_inertia=True, effects=(BACKLASH,))
    section = identification_section(Model({"a": known, "b": unknown}), [])
    parameters, effects, *_ = section.blocks
    assert [row[3] for row in parameters.rows if row[1] == "kp"] == ["N m/rad", "1/s²"]
    assert effects.text == "b: backlash (gap_rad 0.03)"
    assert "does not include the effects" in section.blocks[-1].paragraph


@pytest.mark.parametrize("kd", [0.01, 0.06, 0.119, 2 * math.sqrt(2.0 * 0.002), 0.2, 5.0])
def test_step_response_agrees_with_simulation(kd):
    joint = JointModel(2.0, kd, 0.05, 0.002)
    response = step_response(joint)
    t, y = step(lti([2.0], [0.002, kd, 2.0]), T=np.linspace(0, 2, 40_001))
    assert response["half_time_s"] == pytest.approx(0.05 + t[np.argmax(y >= 0.5)], abs=1e-4)
    assert response["overshoot"] == pytest.approx(max(0.0, y.max() - 1), abs=1e-3)


def test_a_pendulum_stiffens_the_servo():
    free = JointModel(2.0, 0.06, 0.05, 0.02, load=Load(0.02))
    hung = replace(free, load=Load(0.02, 0.5, 0.2))
    hung_at, free_at = (step_response(x)["natural_frequency_rad_s"] for x in (hung, free))
    ratio = hung_at / free_at
    assert ratio**2 == pytest.approx(1 + 0.5 * 9.80665 * 0.2 / 2.0)


def test_words_for_how_it_settles():
    def words(kp, kd):
        return describe_response("j1", JointModel(kp, kd, 0.05, 0.002))

    assert "does not settle" in words(2.0, 0.0)
    assert "overshoots a step by" in words(2.0, 0.06)
    assert "does not overshoot" in words(2.0, 1.0)
    assert "does not follow" in words(0.0, 0.06)


def test_a_first_column_of_names_is_text_even_if_they_begin_with_a_digit():
    rows = [("2D-1 drag coefficient", "5.6592", "1.43 %"), ("1 joint: boxes stopped", "0", "–")]
    assert Table(("", "ours", "error"), rows).numeric == (False, True, True)
    assert Table(("cells", "error"), [("96", "18 %"), ("192", "7.5 %")]).numeric == (True, True)
    units = [("kp", "0.0304 N m/(rad s)"), ("gap", "0.733° per N m"), ("limit", "3.55e+04 rad/s²")]
    assert Table(("", "j1"), units).numeric == (False, True)


def test_long_names_may_break_and_units_and_numbers_do_not():
    cells = ("command_latency_s", "0.0676 rad/s", "a<b/c.d_longer", "98.4 %")
    page = render_page("t", "", [Section("s", "", [Table(("",) * 4, [cells])])], {})
    assert "command_<wbr>latency_<wbr>s" in page and "0.0676 rad/s" in page
    assert "a&lt;b/<wbr>c.<wbr>d_<wbr>longer" in page and "98.4\N{NO-BREAK SPACE}%" in page


def test_a_change_is_never_minus_nothing():
    changes = [change_text(1.0, x) for x in (0.48, 2.2, 0.999, 1.0)]
    assert changes == ["-52 %", "+120 %", "0 %", "0 %"]
    assert change_text(0.0, 1.0) == "-"
