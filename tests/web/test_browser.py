"""The main path of each page in headless Chromium; then a reload in a phone's width. Names, contrast, widths."""

from __future__ import annotations

import importlib.util
import json
import shutil
import time
import zipfile
from pathlib import Path

import pytest

pytest.importorskip("nicegui")

from mckibben import Scenario
from mckibben.component.schema import read_component
from mckibben.dataset import Recipe
from mckibben.muscle import Muscle
from mckibben.web import project, workbench

ROOT = Path(__file__).parents[2]
_spec = importlib.util.spec_from_file_location("benchmarks_web", ROOT / "benchmarks" / "web.py")
chrome = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(chrome)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chrome.chromium() is None, reason="no Chromium is installed: apt-get install chromium"),
]

WIDTHS = {"wide": 1200, "phone": 390}
OPERATED = ("button", "textbox", "slider", "combobox", "checkbox", "switch", "spinbutton", "link")

# Texts with too little contrast to the next background that is not transparent (WCAG 2.1, level AA).
FAINT = """(() => {
  const rgb = (text) => (text.match(/[\\d.]+/g) || []).map(Number);
  const linear = (v) => v / 255 <= 0.03928 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4;
  const light = ([r, g, b]) => 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
  const found = [];
  for (const one of document.querySelectorAll('body *')) {
    const text = [...one.childNodes].filter((n) => n.nodeType === 3).map((n) => n.data).join('').trim();
    const look = getComputedStyle(one), shown = one.getBoundingClientRect().width && look.visibility !== 'hidden';
    if (!text || !shown || one.closest('.q-icon, [disabled], svg')) continue;
    let ground = [255, 255, 255];
    for (let under = one; under; under = under.parentElement) {
      const color = rgb(getComputedStyle(under).backgroundColor);
      if (color.length === 3 || color[3] === 1) { ground = color; break; }
    }
    const [low, high] = [light(rgb(look.color)), light(ground)].sort((a, b) => a - b);
    const ratio = (high + 0.05) / (low + 0.05), size = parseFloat(look.fontSize);
    const large = size >= 24 || (size >= 18.66 && look.fontWeight >= 700);
    if (ratio < (large ? 3 : 4.5)) found.push(`${text.slice(0, 30)}: ${ratio.toFixed(2)}`);
  }
  return found;
})()"""

# Selected names that do not fit their field.
CUT = """[...document.querySelectorAll('.q-select .q-field__native > span')]
    .filter((e) => e.scrollWidth > e.clientWidth + 1).map((e) => e.innerText)"""

# Counts what 3-D scenes draw.
DRAWS = """(() => {
  const drawing = WebGL2RenderingContext.prototype, draw = drawing.drawElements;
  window.draws = 0;
  drawing.drawElements = function () { window.draws += 1; return draw.apply(this, arguments); };
})()"""


@pytest.fixture(scope="module")
def opened():
    """Address of a server, and a tab."""
    with chrome.served() as printed, chrome.browser() as tab:
        yield tab.enter(printed), tab


@pytest.fixture
def page(opened):
    """Opens a page in both widths, with an action in the first; checks what any page has to be."""
    address, tab = opened

    def visit(path, act, still):
        tab.errors.clear()
        tab.requests.clear()
        for name, width in WIDTHS.items():
            tab.open(f"{address}{path}", width, 900)
            if name == "wide":
                act(tab)
            tab.wait(still)
            time.sleep(0.3)
            assert tab.evaluate("document.documentElement.scrollWidth <= window.innerWidth"), name
            assert tab.evaluate(FAINT) == []
            assert tab.evaluate(CUT) == []
            assert unnamed(tab) == []
        assert tab.errors == []
        own = (address, address.replace("http", "ws"), "data:", "blob:")
        assert [one for one in tab.requests if not one.startswith(own)] == []

    return visit


def unnamed(tab):
    """What a user operates and assistive programs have no name for, or no way to."""
    found = []
    for node in tab.send("Accessibility.getFullAXTree")["nodes"]:
        role = node.get("role", {}).get("value")
        if node.get("ignored") or role not in OPERATED:
            continue
        properties = {one["name"]: one["value"].get("value") for one in node.get("properties", ())}
        reached = properties.get("focusable") or properties.get("disabled") or role == "slider"  # keys reach its inside
        if not node.get("name", {}).get("value", "").strip() or not reached:
            found.append((role, node.get("name", {}).get("value"), properties))
    return found


def shows(text):
    return f"document.body?.innerText.includes({json.dumps(text)})"


def scroll_down(tab):
    tab.evaluate("document.body.style.paddingBottom = '1000px', window.scrollTo(0, 800)")
    tab.wait("window.scrollY > 700")


def test_a_slider_of_the_joint_moves_curve_and_drawing_by_keys(page):
    def act(tab):
        tab.wait(chrome.DRAWING)
        drawn = "document.querySelector('svg[role=img]').innerHTML"
        before = tab.evaluate(drawn)
        tab.evaluate("(s => (s.querySelector('[tabindex]') || s).focus())(document.querySelector('.q-slider'))")
        for _ in range(4):
            tab.press("ArrowRight", 39)
        tab.wait(f"{drawn} !== {json.dumps(before)}")

    page("/", act, chrome.FIRST_CURVE)


def test_pasted_points_are_fitted_and_still_there_after_a_reload(page):
    def act(tab):
        tab.wait("document.querySelector('.q-expansion-item .q-item')")
        time.sleep(0.5)
        tab.evaluate("document.querySelector('.q-expansion-item .q-item').click()")
        time.sleep(0.5)
        tab.evaluate(chrome.PASTE % json.dumps(chrome.DATA.read_text(encoding="utf-8")))
        time.sleep(0.5)
        chrome.click(tab, "Read")
        tab.wait(shows("204 points, 31 slack"))
        chrome.click(tab, "Fit")

    page("/identify", act, shows("ExponentialLaw: F =") + " && " + chrome.FIRST_CURVE)


def test_a_run_is_computed_changed_kept_and_played(page):
    def act(tab):
        tab.wait(chrome.FIRST_CURVE + " && " + shows("completed"))
        chrome.click(tab, "Keep this run")
        tab.wait(shows("run 1"))
        scroll_down(tab)
        tab.evaluate(SET_NUMBER % ("angle amplitude", 9))
        tab.wait("document.querySelector('textarea').value.includes('amplitude: 9 deg')")
        assert tab.evaluate("window.scrollY") > 700  # the next field can be changed
        chrome.click(tab, "Run")
        tab.wait("window.scrollY < 300")
        tab.wait("document.querySelector('canvas[data-engine^=\"three\"]')")
        time.sleep(2.0)
        tab.evaluate(DRAWS)
        time.sleep(1.0)
        assert tab.evaluate("window.draws") == 0  # nothing moves
        tab.evaluate("document.querySelector('.q-toggle[aria-label=play], .q-toggle').click()")
        tab.wait(shows("0.50 s"))
        assert tab.evaluate("window.draws") > 0

    page("/run", act, shows("run 1"))


def test_a_test_on_the_rig_is_drawn_and_vented(page):
    def act(tab):
        time.sleep(0.5)
        chrome.click(tab, "Start")
        tab.wait(shows(" of ") + " && " + chrome.FIRST_CURVE)
        chrome.click(tab, "Vent")

    page("/rig", act, shows("vented by hand"))


def test_a_refused_scenario_leaves_the_old_curves_greyed_below_its_problem_in_view(page):
    def act(tab):
        tab.wait(chrome.FIRST_CURVE + " && " + shows("completed"))
        tab.evaluate(chrome.PASTE % json.dumps(workbench.START.replace("amplitude: 10 deg", "amplitude: 10 kg")))
        time.sleep(0.5)
        scroll_down(tab)
        chrome.click(tab, "Run")
        tab.wait("window.scrollY < 300")
        hint = "getComputedStyle(document.querySelector('.q-table__middle')).backgroundAttachment"
        assert tab.evaluate(hint) == "local, local, scroll, scroll"  # a shadow where the table continues
        parts = "[...document.querySelectorAll('.q-table td')[1].childNodes].filter(n => n.data).map(n => n.data)"
        assert tab.evaluate(parts) == ["reference.", "angle.", "amplitude"]
        assert tab.evaluate("document.querySelectorAll('.q-table td')[1].innerText") == "reference.angle.amplitude"

    page("/run", act, shows("problem") + " && document.querySelector('.stale canvas')")


def test_a_study_is_computed_shown_and_cancelled(page):
    def act(tab):
        tab.wait(shows("No study yet"))
        chrome.click(tab, "Compare")
        tab.wait(shows("Cancel"))
        tab.resize(WIDTHS["phone"], 900)
        tab.wait(
            "(r => r.height && r.top > innerHeight / 2)(document.querySelector('.progress').getBoundingClientRect())"
        )
        tab.resize(WIDTHS["wide"], 900)
        chrome.click(tab, "Cancel")
        tab.wait(shows("cancelled"))
        tab.wait(
            "![...document.querySelectorAll('button')].some(b => b.innerText.trim() === 'Cancel' && b.offsetParent)"
        )
        tab.evaluate(SET_NUMBER % ("iterations", 2))
        time.sleep(0.5)
        scroll_down(tab)
        chrome.click(tab, "Tune")
        tab.wait(shows("points evaluated"), 240)
        tab.wait("window.scrollY < 300")

    page("/tune", act, shows("points evaluated") + " && " + chrome.FIRST_CURVE)


# Sets the number field of a label.
SET_NUMBER = """((label, value) => {
  const field = [...document.querySelectorAll('input[type=number]')].find(one => one.ariaLabel === label);
  Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set.call(field, value);
  field.dispatchEvent(new Event('input', {bubbles: true}));
})('%s', %d)"""


def test_a_leg_lands_in_space_and_is_played(page):
    def act(tab):
        time.sleep(0.5)
        scroll_down(tab)
        chrome.click(tab, "Compute")
        tab.wait(shows("Motion"), 300)
        tab.wait("window.scrollY < 300")
        tab.wait("document.querySelector('canvas[data-engine^=\"three\"]').width > 0")  # hidden before
        tab.evaluate("document.querySelector('.q-toggle[aria-label=play], .q-toggle').click()")
        tab.wait("/0\\.0[1-9]\\d s/.test(document.body.innerText)")
        cell = "[...document.querySelectorAll('td')].find((e) => e.innerText === '20 mm')"
        assert tab.evaluate(f"getComputedStyle({cell}).whiteSpace") == "nowrap"

    page("/leg", act, shows("Motion") + " && " + chrome.FIRST_CURVE)


def test_an_own_muscle_goes_from_points_to_joint_run_and_study_and_its_downloads_are_read(page, tmp_path):
    def act(tab):
        tab.send("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
        tab.wait("document.querySelector('input[type=file]')")
        time.sleep(1.0)
        chrome.upload(tab, shutil.copy(chrome.DATA, tmp_path / "own.csv"))
        tab.wait(shows("own.csv") + " && " + shows("204 points, 31 slack") + " && !" + shows("Design a joint with it"))
        chrome.click(tab, "Fit")
        tab.wait(shows("Design a joint with it"))
        chrome.click(tab, "Download muscle")
        chrome.click(tab, "Design a joint with it")
        tab.wait("location.pathname === '/' && " + chrome.DRAWING, 120)
        tab.wait(shows("the load is held"), 120)
        chrome.click(tab, "Download YAML")
        tab.wait(shows("It needs muscle.yaml"))
        chrome.click(tab, "Run this joint")
        ran = "[...document.querySelectorAll('textarea')].some(one => one.value.includes('muscle.yaml'))"
        tab.wait(f"location.pathname === '/run' && {ran} && " + shows("completed"), 120)  # not an earlier scenario
        chrome.click(tab, "Download project")
        tab.open(tab.evaluate("location.origin") + "/tune")
        tab.wait(shows("No study yet") + " || " + shows("points evaluated"))
        time.sleep(0.5)
        tab.evaluate(SET_NUMBER % ("iterations", 1))
        time.sleep(0.5)
        chrome.click(tab, "Tune")
        tab.wait("document.querySelector('.progress').getBoundingClientRect().height")
        tab.wait("!document.querySelector('.progress').getBoundingClientRect().height", 240)
        chrome.click(tab, "Run the tuned scenario")
        tab.wait("location.pathname === '/run' && " + shows("completed"), 120)
        tab.open(tab.evaluate("location.origin") + "/identify")

    page("/identify", act, shows("Design a joint with it"))
    for name in ("muscle", "project"):
        (tmp_path / name).mkdir()
        with zipfile.ZipFile(tmp_path / f"{name}.zip") as packed:
            packed.extractall(tmp_path / name)
    muscle, kept = (read_component(Muscle, tmp_path / name / "muscle.yaml") for name in ("muscle", "project"))
    assert muscle == kept == Scenario.read(tmp_path / "project" / "scenario.yaml").joint.muscle1
    recipe = Recipe.parse((tmp_path / "muscle" / "recipe.yaml").read_text(encoding="utf-8"))
    assert len(recipe.dataset(chrome.DATA)) == 204
    assert (tmp_path / "joint.yaml").read_text().startswith("joint:")


def test_a_project_is_uploaded_runs_and_is_offered_for_download(page, tmp_path):
    text = workbench.START.replace("name: knee", "name: of a project").replace("amplitude: 10 deg", "amplitude: 7 deg")
    (tmp_path / "project.zip").write_bytes(project.pack(tmp_path, text, None))

    def act(tab):
        tab.wait(chrome.FIRST_CURVE + " && " + shows("completed"))
        chrome.upload(tab, tmp_path / "project.zip", "input[accept='.zip']")
        tab.wait("document.querySelector('textarea[aria-label=scenario]').value.includes('of a project')")
        chrome.click(tab, "Download project")

    page("/run", act, shows("completed") + " && document.querySelector('textarea').value.includes('7 deg')")
