"""The page in a real browser: what a user sees of what was rendered, and what their hands change."""

import time
from pathlib import Path

import numpy as np
import pytest
from chromium import CHROMIUM, Browser
from PIL import Image

from samira_warp.avatar import Avatar, read_frames
from samira_warp.avatar.storage import find_avatar
from samira_warp.io.images import resize_box
from samira_warp.view.config import ViewConfig
from samira_warp.view.lights import Lights
from samira_warp.view.ports import free_port
from samira_warp.view.posing import Poser
from samira_warp.view.scene import Scene, Shown, Sides

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine"),
    # a picture may be under way to a browser that has just gone
    pytest.mark.filterwarnings("ignore:Queued a .* on a closed connection"),
]

CANVAS = "document.querySelector('canvas').getBoundingClientRect()"
SECONDS = 60.0


@pytest.fixture(scope="module")
def shown(tiny_run):
    folder = find_avatar(tiny_run)
    avatar = Avatar.load(folder)
    return Shown(avatar, folder, Poser(read_frames(folder), avatar.canonical.template))


@pytest.fixture(scope="module")
def server(shown):
    from samira_warp.view.server import Server

    config = ViewConfig(avatar=shown.folder, host="127.0.0.1")
    server = Server(Scene(shown, Lights()), config, port=free_port("127.0.0.1", 0), progress=None)
    yield server
    server.end()


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.end()


def until(holds):
    end = time.monotonic() + SECONDS
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.fixture
def opened(server, browser, shown):
    """``opened()`` is a page and its session; all are closed after the test."""
    pages = []

    def open_page():
        before = server.sessions()
        page = browser.open(server.address)
        pages.append(page)
        until(lambda: len(server.sessions()) > len(before))
        (session,) = [session for session in server.sessions() if session not in before]
        page.until("document.querySelector('[role=tab]') !== null", SECONDS)
        rest(session)
        assert_shows(page, shown, session)  # a page fades in
        return page, session

    yield open_page
    for page in pages:
        browser.vanish(page)
    until(lambda: server.sessions() == [])


def rest(session):
    """Wait until a session's picture is as fine as its window, for as long as messages are under way."""
    for _ in range(3):
        until(lambda: session.due() == float("inf"))
        time.sleep(0.2)


def seen(page):
    """(48, 64, 3) the middle half of what a page shows in its window, small; nothing lies over it there."""
    box = page.evaluate(f"(() => {{ const b = {CANVAS}; return [b.x, b.y, b.width, b.height] }})()")
    x, y, width, height = (round(value) for value in box)
    return middle(page.screenshot()[y : y + height, x : x + width])


def middle(picture):
    """(48, 64, 3) the middle of a picture, half its size, in which no two sizes of it differ by much."""
    height, width = picture.shape[:2]
    part = picture[height // 4 : height - height // 4, width // 4 : width - width // 4]
    return resize_box(part.astype(np.float32), width=64, height=48)


def wanted(shown, session):
    """What the middle should be, rendered anew; the browser has fewer pixels while it is slow."""
    width, height = session.window
    return middle(Scene(shown, Lights()).picture(session.state, Sides.new(), width=width, height=height))


def assert_shows(page, shown, session):
    """The page shows the state: what is left is JPEG, and edges that lie between two sizes' pixels."""
    until(lambda: abs(seen(page) - wanted(shown, session)).mean() < 2.0)
    # it is a picture of a head, not of the background
    assert wanted(shown, session).std() > 20.0


def press(page, label, key, *, times):
    """Press a key on the slider of a label."""
    found = page.evaluate(
        "(() => { for (const label of document.querySelectorAll('label')) {"
        f" if (label.innerText.trim() !== {label!r}) continue;"
        " for (let row = label; row; row = row.parentElement) {"
        " const thumb = row.querySelector('[role=slider]');"
        " if (thumb) { thumb.scrollIntoView({block: 'center'}); thumb.focus(); return true; } } }"
        " return false; })()"
    )
    assert found, label
    for _ in range(times):
        page.key(key)


def tick(page, label):
    """Click the checkbox of a label."""
    x, y = page.until(
        "(() => { for (const label of document.querySelectorAll('label')) {"
        f" if (label.innerText.trim() !== {label!r}) continue;"
        " for (let row = label; row; row = row.parentElement) {"
        " const box = row.querySelector('input[type=checkbox]'); if (!box) continue;"
        " box.scrollIntoView({block: 'center'}); const b = box.getBoundingClientRect();"
        " return [b.x + b.width / 2, b.y + b.height / 2]; } } })()"
    )
    page.click(x, y)


def open_tab(page, name):
    x, y = page.until(
        "(() => { for (const tab of document.querySelectorAll('[role=tab]')) {"
        f" if (tab.innerText.trim() !== {name!r}) continue;"
        " const b = tab.getBoundingClientRect(); return [b.x + b.width / 2, b.y + b.height / 2]; } })()"
    )
    page.click(x, y)
    time.sleep(0.5)


def click_button(page, text):
    x, y = page.until(
        "(() => { for (const button of document.querySelectorAll('button')) {"
        f" if (!button.innerText.includes({text!r})) continue;"
        " button.scrollIntoView({block: 'center'});"
        " const b = button.getBoundingClientRect(); return [b.x + b.width / 2, b.y + b.height / 2]; } })()"
    )
    page.click(x, y)


def test_the_page_opens_and_shows_the_head(opened):
    page, session = opened()
    assert session.window[0] > session.window[1] > 300
    assert page.evaluate("document.querySelectorAll('[role=tab]').length") == 6


def test_a_slider_moves_the_picture(opened, shown):
    page, session = opened()
    before = seen(page)
    open_tab(page, "Face")
    press(page, "head, turn", "ArrowRight", times=12)
    until(lambda: session.state.pose.joints != ())
    rest(session)
    ((joint, degrees),) = session.state.pose.joints
    assert (joint, degrees) == ("root", (0.0, 6.0, 0.0))
    assert_shows(page, shown, session)
    assert abs(seen(page) - before).mean() > 1.0


def test_the_light_changes_it(opened, shown):
    page, session = opened()
    before = seen(page)
    open_tab(page, "Light")
    press(page, "Exposure, stops", "ArrowLeft", times=15)
    until(lambda: session.state.light.stops == pytest.approx(-1.5))
    rest(session)
    assert_shows(page, shown, session)
    assert seen(page).mean() < before.mean() - 5.0


def test_the_mouse_goes_round_and_the_wheel_nearer(opened, shown):
    page, session = opened()
    look = session.state.look
    page.drag(400, 360, 120, 0)
    until(lambda: session.state.look.wxyz != look.wxyz)
    rest(session)
    round_it = session.state.look
    center = session.scene.place(session.state).center.numpy()
    distances = [np.linalg.norm(np.asarray(each.position) - center) for each in (look, round_it)]
    assert distances[0] == pytest.approx(distances[1], rel=1e-3)
    assert round_it.position[1] == pytest.approx(look.position[1], abs=1e-3)  # the world's up stays up
    page.mouse("mouseWheel", 400, 360, deltaX=0, deltaY=-300)
    until(lambda: np.linalg.norm(np.asarray(session.state.look.position) - center) < 0.98 * distances[1])
    rest(session)
    assert_shows(page, shown, session)


def test_two_browsers_choose_for_themselves_and_one_may_vanish(opened, server, browser, shown):
    (page, session), (other, its_session) = opened(), opened()
    open_tab(other, "Light")
    press(other, "Turn, degrees", "ArrowRight", times=40)
    until(lambda: its_session.state.light.rotate == 40.0)
    rest(its_session)
    assert session.state.light.rotate == 0.0
    assert_shows(page, shown, session)
    assert_shows(other, shown, its_session)
    browser.vanish(other)
    until(lambda: server.sessions() == [session])
    open_tab(page, "Face")
    press(page, "head, nod", "ArrowRight", times=10)
    until(lambda: session.state.pose.joints != ())
    rest(session)
    assert_shows(page, shown, session)


def test_the_browser_draws_splats(opened, shown):
    """They are shaded before they are blended, without what of the head hides them: nearly the picture."""
    page, session = opened()
    open_tab(page, "Look")
    tick(page, "Splats, drawn by the browser")
    until(lambda: session.state.splats)
    rest(session)
    until(lambda: abs(seen(page) - wanted(shown, session)).mean() < 8.0)
    # turned by the browser alone: nothing is made until its camera rests
    look = session.state.look
    page.drag(400, 360, 120, 0)
    until(lambda: session.state.look.wxyz != look.wxyz)
    rest(session)
    until(lambda: abs(seen(page) - wanted(shown, session)).mean() < 8.0)
    tick(page, "Splats, drawn by the browser")
    until(lambda: not session.state.splats)
    rest(session)
    assert_shows(page, shown, session)


def test_a_snapshot_is_downloaded_at_twice_the_size(opened, shown, tmp_path):
    page, session = opened()
    page.call("Page.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
    open_tab(page, "Save")
    windows = {session.window}
    click_button(page, "Snapshot")
    file = Path(tmp_path / "snapshot.png")

    def is_there():
        windows.add(session.window)
        return file.exists()

    until(is_there)
    with Image.open(file) as image:
        picture = np.asarray(image)
    height, width = picture.shape[:2]
    assert (width / 2, height / 2) in windows
    assert abs(middle(picture) - wanted(shown, session)).mean() < 1.0


def test_the_sequence_plays_and_stays_where_it_is_stopped(opened, shown):
    page, session = opened()
    click_button(page, "Play")
    played = set()

    def has_played():
        played.add(session.state.pose.frame)
        return len(played) == len(shown.poser.frames)

    until(has_played)
    until(lambda: session.state.pose.frame != 0)
    click_button(page, "Pause")
    rest(session)
    stopped = session.state.pose.frame
    time.sleep(1.0)
    assert session.state.pose.frame == stopped
    assert_shows(page, shown, session)
    name = shown.poser.frames[stopped].name
    page.until(f"[...document.querySelectorAll('input')].some(input => input.value === {name!r})")
