"""The documentation as a site: it builds without a warning, loads nothing from other sites, and lacks no page."""

import contextlib
import pathlib
import re
import subprocess
import sys
from html.parser import HTMLParser

import pytest

import pushfric_core
from pushfric_core.commands.cli import catalog

ROOT = pathlib.Path(__file__).resolve().parents[2]

pytestmark = pytest.mark.timeout(900)  # two notebooks run


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    out = tmp_path_factory.mktemp("site") / "site"
    build = [sys.executable, ROOT / "docs/build_site.py", "--out", out]
    done = subprocess.run(build, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    return out


class Loaded(HTMLParser):
    """Collects what a browser loads with a page."""

    def __init__(self):
        super().__init__()
        self.addresses = []

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.addresses += [given[name] for name in ("src", "data") if given.get(name)]
        if tag == "link":
            self.addresses.append(given["href"])


def test_every_page_is_reached_from_the_front_page(site):
    front = (site / "index.html").read_text()
    pages = {page.stem for page in (ROOT / "docs").glob("*.md")} - {"api", "index"} | {"commands", "python", "contributing"}
    assert {name for name in pages if f'href="{name}.html"' not in front} == set()


def test_the_reference_has_every_command_and_every_public_name(site):
    commands, names = ((site / f"{page}.html").read_text() for page in ("commands", "python"))
    assert [name for name in catalog() if f">pushfric {name}<" not in commands] == []
    public = {name for name in pushfric_core.__all__ if name in pushfric_core._HOMES}
    assert {name for name in public if not re.search(rf'id="pushfric_core\.[a-z0-9_.]*{name}"', names)} == set()


def test_the_front_page_has_the_film_a_command_and_three_doors(site):
    front = (site / "index.html").read_text()
    assert 'src="_images/demo.webp"' in front
    assert re.findall(r"<p>(Operator|Researcher|Planner)</p></th>", front) == ["Operator", "Researcher", "Planner"]


def test_the_notebook_was_run(site):
    text = (site / "data_to_verdict.html").read_text()
    assert text.count('class="output ') == 6
    assert text.count("data:image/png;base64") + len(re.findall(r'src="_images/[0-9a-f]{64}\.png"', text)) == 1
    assert "omega is in deg" in text


def test_formulas_are_drawn_by_the_browser_itself(site, browser):
    with contextlib.closing(browser.new_page()) as page:
        for name in ("derivation", "limit_surface"):
            page.goto((site / f"{name}.html").as_uri())
            text = page.locator("article").inner_text()
            assert not re.search(r"\$|\\[a-z]", text), "a formula that was not translated"
        page.goto((site / "derivation.html").as_uri())
        formula = page.locator('math[display="block"]').first
        assert formula.locator("munder, munderover, msub, msubsup").count() > 3
        subscript, line = formula.locator("msub > :last-child, msubsup > :last-child").first, formula.locator("mi").first
        assert subscript.bounding_box()["height"] < formula.bounding_box()["height"] / 2
        assert line.evaluate("mi => mi.namespaceURI") == "http://www.w3.org/1998/Math/MathML"


CUT_OFF = """() => {
  const width = document.documentElement.clientWidth;
  return [...document.querySelectorAll("article pre, article table, article img")]
    .filter(one => one.scrollWidth > one.clientWidth + 1 || one.getBoundingClientRect().right > width + 1)
    .map(one => one.textContent.slice(0, 60));
}"""


def test_nothing_is_cut_off_on_paper_or_makes_a_phone_scroll_sideways(site, browser):
    with contextlib.closing(browser.new_page()) as page:
        for file in site.glob("*.html"):
            page.goto(file.as_uri())
            page.emulate_media(media="print")
            page.set_viewport_size({"width": 718, "height": 1000})  # A4 with margins of 1 cm
            assert page.evaluate(CUT_OFF) == [], file.name
            page.emulate_media(media="screen")
            page.set_viewport_size({"width": 360, "height": 740})
            assert page.evaluate("document.documentElement.scrollWidth") == 360, file.name


def test_nothing_is_loaded_from_elsewhere(site):
    loaded = Loaded()
    for page in site.glob("*.html"):
        loaded.feed(page.read_text())
    assert len(loaded.addresses) > 20
    assert [address for address in loaded.addresses if re.match(r"(https?:)?//", address)] == []
    styles = "".join(style.read_text() for style in site.glob("_static/**/*.css"))
    assert re.findall(r"url\(['\"]?https?:[^)]*", styles) == []


@pytest.mark.parametrize(
    ("name", "kind", "copied"),
    [
        ("pushes", "sh", "./pushfric estimate bags/rubber_rect4 --grid 9 5\n"),
        (
            "tutorial",
            "console",
            "./pushfric estimate runs/my_box --save my_box.yaml\n./pushfric predict my_box.yaml --pushes pushes.csv",
        ),
    ],
)
def test_a_button_copies_a_block_and_of_a_session_the_commands(site, browser, name, kind, copied):
    with contextlib.closing(browser.new_context(permissions=["clipboard-read", "clipboard-write"])) as context:
        page = context.new_page()
        page.goto((site / f"{name}.html").as_uri())
        button = page.locator(f".highlight-{kind} button").last
        button.hover()
        button.click()
        page.wait_for_function("button => button.textContent === 'Copied'", arg=button.element_handle())
        assert page.evaluate("navigator.clipboard.readText()") == copied
