"""Reports in a real browser: nothing is fetched, nothing complains, all of it fits on a phone and on paper."""

import re
import shutil
import subprocess

import pytest
from click.testing import CliRunner

from linkside import cli

from .robots import DATA

BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
ARM = DATA / "arm2_square_mismatch"
COMMANDS = {
    "estimate": ("robot.yaml", "log.parquet", "--with", "ekf", "--out", "out.parquet"),
    "place": ("robot.yaml", "log.parquet", "--link", "fore", "--steps", "2"),
    "excite": ("robot.yaml", "--out", "m.csv", "--duration", "3", "--rate", "500", "--evaluations", "2"),
}
LIMITS = [("--velocity", "2"), ("--torque", "6e3")]

pytestmark = pytest.mark.skipif(BROWSER is None, reason="there is no Chromium")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages")
    for file in ("robot.yaml", "robot.urdf", "log.parquet"):
        shutil.copy(ARM / file, folder)
    return folder


@pytest.fixture(params=COMMANDS)
def report(request, folder, monkeypatch):
    monkeypatch.chdir(folder)
    page = folder / f"{request.param}.html"
    given = [f"{option} {joint}={value}" for option, value in LIMITS for joint in ("axis2", "axis3")]
    limits = " ".join(given).split() if request.param == "excite" else []
    done = CliRunner().invoke(cli.main, [request.param, *COMMANDS[request.param], *limits, "--report", str(page)])
    assert done.exit_code == 0, done.output
    return page


def browse(page, *options):
    """What the browser prints: the page's elements as they are in the end, or what it complains of."""
    fixed = ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--enable-logging=stderr")
    alone = ("--host-resolver-rules=MAP * ~NOTFOUND", f"--user-data-dir={page.parent / 'profile'}")
    command = [BROWSER, *fixed, *alone, *options, page.as_uri()]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)


PROBE = """<script>addEventListener("load", () => {
  const fetched = performance.getEntriesByType("resource").map(one => one.name).filter(one => !one.startsWith("data:"));
  console.log(["seen", document.documentElement.scrollWidth, ...fetched].join(" "));
})</script></body>"""


def seen(page, text):
    """All that a phone's console says of a page, which the probe ends with its width and what was fetched."""
    probed = page.with_stem(f"{page.stem}_probed")
    probed.write_text(text.replace("</body>", PROBE))
    picture = probed.with_suffix(".png")
    said = browse(probed, "--window-size=500,1200", f"--screenshot={picture}").stderr  # Chromium's least width
    return re.findall(r"CONSOLE[^\"]*\"([^\"]*)\"", said)


def test_a_report_is_whole_in_a_browser(report):
    (said,) = seen(report, report.read_text())
    word, width, *fetched = said.split()
    assert word == "seen"
    assert int(width) <= 500, "the page is wider than a phone"
    assert fetched == []
    assert report.with_name(f"{report.stem}_probed.png").stat().st_size > 20_000
    browse(report, f"--print-to-pdf={report.with_suffix('.pdf')}")
    assert report.with_suffix(".pdf").stat().st_size > 20_000


def test_what_is_wrong_with_a_page_is_noticed(tmp_path):
    """The test above can fail."""
    wide = "<div style='width: 900px'>wide</div>" + "".join(f"<p>{number}</p>" for number in range(300))
    text = f"<body>{wide}<script>missing()</script><img src='https://example.org/x.png'></body>"
    complaint, said = seen(tmp_path / "wrong.html", text)
    assert "missing is not defined" in complaint
    assert int(said.split()[1]) > 800
    assert said.split()[2:] == ["https://example.org/x.png"]
