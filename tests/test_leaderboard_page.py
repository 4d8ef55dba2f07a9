"""The leaderboard's page in a real browser: it shows the table's figures, and everything on it can be used."""

import itertools
import re
import shutil
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
import pandas as pd
import pytest

from benchmark.scoring.ceiling import Ceiling
from benchmark.scoring.leaderboard_page import page
from benchmark.scoring.oracle_scores import with_oracles
from benchmark.scoring.ranking import counted, leaderboard, protocols_of
from benchmark.scoring.suite_table import standing
from benchmark.settings.config import ConditionConfig
from envs.block_push.task import BLOCK_PUSH

pytestmark = pytest.mark.system

PAPER, STRICT = PROTOCOLS = protocols_of(BLOCK_PUSH)
RESULTS = Path(__file__).parents[1] / "results"
QUIET = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--window-size=1400,1000",
]  # fmt: skip


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if not (chromium and driver):
        pytest.skip("No Chromium on this machine. On Debian: sudo apt-get install chromium chromium-driver")
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for argument in [*QUIET, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"]:
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    browser = webdriver.Chrome(options, webdriver.ChromeService(driver))
    yield browser
    browser.quit()


@pytest.fixture(scope="module")
def tables(transfer_episodes):
    ours = {*transfer_episodes.checkpoint_hash}
    return {
        x: with_oracles(
            leaderboard(counted(transfer_episodes, x, ours), x, BLOCK_PUSH), transfer_episodes, x, BLOCK_PUSH
        )
        for x in PROTOCOLS
    }


@pytest.fixture(scope="module")
def standings(transfer_episodes):
    """Of two made-up suites: with head-room on the UR3, and with none."""
    rows = counted(transfer_episodes, STRICT, {*transfer_episodes.checkpoint_hash})
    scenes, policies = sorted({*rows.episode_seed}), sorted({*rows.checkpoint})
    ceiling = Ceiling(tuple(scenes), tuple(policies), ("1" * len(scenes),) * len(policies), {})
    easy = ConditionConfig("ur5", "block_push", saturated=True)
    suites = {
        "mine": {"here": ConditionConfig("ur3", "block_push", cause="outer reach"), "there": easy},
        "easy": {"there": easy},
    }
    return [standing(name, of, dict.fromkeys(of, ceiling), rows) for name, of in suites.items()]


@pytest.fixture(scope="module")
def file(tables, standings, tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    frames = np.zeros((2, 30, 40, 3), np.uint8)
    frames[1] = 255
    imageio.imwrite(folder / "ur3-embodied-lambda0.5-100000.webp", frames, duration=100, loop=0)
    (folder / "leaderboard.html").write_text(page(BLOCK_PUSH, tables, folder, standings=standings))
    return folder / "leaderboard.html"


@pytest.fixture
def opened(browser, file):
    """The page, freshly opened, and nothing to complain about when the test is over."""

    def open_(view=""):
        browser.get("about:blank")
        browser.get(f"{file.as_uri()}{view}")
        return browser

    open_()
    browser.get_log("browser")
    yield open_
    assert browser.get_log("browser") == []


def choose(browser, name, value):
    from selenium.webdriver.support.select import Select

    Select(browser.find_element("name", name)).select_by_value(value)


def column(browser, title, table="ranking"):
    """Texts below a column's title."""
    cells = browser.find_elements("css selector", f"#{table} thead th")
    titles = [cell.text.split("\n")[0].strip(" ↕↑↓") for cell in cells]
    rows = browser.find_elements("css selector", f"#{table} > tbody > tr:not(.group)")
    return [row.find_elements("css selector", ":scope > td")[titles.index(title)].text for row in rows]


def groups(browser, title, table="ranking"):
    """The same of each part of a table, by the part's title."""
    parts, texts = {}, iter(column(browser, title, table))
    for row in browser.find_elements("css selector", f"#{table} > tbody > tr"):
        if row.get_attribute("class") == "group":
            part = parts.setdefault(row.text, [])
        else:
            part.append(next(texts))
    return parts


def first_number(text):
    return float(re.search(r"[\d.]+", text)[0])


def test_it_shows_the_figures_of_the_table_and_fetches_nothing(opened, tables):
    browser = opened()
    shown = [first_number(text) for text in column(browser, "p2")]
    assert shown == pytest.approx((100 * tables[STRICT].p2).tolist(), abs=0.051)
    assert column(browser, "n") == [f"{n}*" for n in tables[STRICT].n]
    browser.find_element("tag name", "summary").click()
    about = browser.find_element("id", "about").text
    assert about.startswith(f"{sum(table.n.sum() for table in tables.values())} episodes") and "commit c1" in about
    fetched = browser.execute_script("return performance.getEntriesByType('resource').map(x => x.name)")
    assert all(name.startswith("data:") for name in fetched)
    assert not re.search(r"""(src|href)=["'](?!data:|#)|@import|url\((?!data:)""", browser.page_source)
    choose(browser, "protocol", "paper")
    shown = [first_number(text) for text in column(browser, "score")]
    assert shown == pytest.approx((100 * tables[PAPER].score).tolist(), abs=0.051)
    of_paper = dict(zip(column(browser, "λ"), column(browser, "paper's score"), strict=True))
    assert (of_paper["0.5"], of_paper["1"]) == ("91.3 (87.8 to 96.0)",) * 2
    assert "64.6 (62.8 to 71.9)" in column(browser, "paper's score")


def ranked(browser):
    """The ranking of a suite, by method and column."""
    titles = [cell.text.replace("\n", " ") for cell in browser.find_elements("css selector", "#methods thead th")]
    return {
        row.find_element("tag name", "th").text: dict(
            zip(titles[1:], [cell.text for cell in row.find_elements("tag name", "td")], strict=True)
        )
        for row in browser.find_elements("css selector", "#methods tbody tr")
    }


def press(browser, group, text):
    (button,) = [x for x in browser.find_elements("css selector", f"#{group} button") if x.text == text]
    button.click()


def number(text):
    return float(re.search(r"[−+]?[\d.]+", text)[0].replace("−", "-"))


def test_it_begins_with_how_methods_rank_and_what_they_gain_on_each_condition(opened, standings):
    browser, (mine, _) = opened(), standings
    order = "return [...document.querySelectorAll('h2, h3, table, #curves, #causes')].map(x => x.id || x.textContent)"
    seen = browser.execute_script(order)
    assert seen[:3] == ["How to read it", "Which method gains most", "methods"]
    assert seen.index("methods") < seen.index("ranking") < seen.index("curves") < seen.index("causes")
    assert seen[-1] == "How to submit"
    led = "[...document.querySelectorAll('nav a')].map(x => [x.text, document.querySelector(x.hash).textContent])"
    assert all(title in text for title, text in browser.execute_script(f"return {led}"))
    shown, ranking = ranked(browser), mine.ranking.set_index("method")
    assert [*shown][-2:] == ["direct", "ceiling"] and len(shown) == len(mine.methods) + 2 == 5
    assert [name.split()[0] for name in shown][:-2] == [*mine.methods.method]
    for row in mine.table.to_dict("records"):
        if row["method"] == "direct":
            assert number(shown["direct"][_title(row)]) == pytest.approx(100 * row["score"], abs=0.051)
            assert number(shown["ceiling"][_title(row)]) == 100
            continue
        cells = shown[f"{row['method']} {row['lambda']:g}"]
        assert number(cells[_title(row)]) == pytest.approx(100 * row["difference"], abs=0.051)
        assert number(cells["share"]) == pytest.approx(100 * ranking.share[row["method"]], abs=0.051)
        assert number(cells["worst"]) == pytest.approx(100 * ranking.worst[row["method"]], abs=0.051)
        if row["method"] == "pull-back":  # It was not rolled out on the saturated condition.
            assert cells["harm"] == cells["there saturated"] == "–"
        else:
            assert number(cells["harm"]) == pytest.approx(100 * ranking.harm[row["method"]], abs=0.051)
    assert shown["projection 0.01"]["needs"] == "arm's description" and shown["pull-back 1"]["needs"] == "not stated"


def _title(row):
    return row["condition"] + (" saturated" if row["saturated"] else "")


def test_each_figure_has_its_interval(opened, standings):
    browser, cells = opened(), standings[0].table.set_index(["method", "condition"])
    shown = browser.find_elements("css selector", "#methods tbody td.condition [title]")
    assert len(shown) == 9  # Three methods, of which one lacks a condition, direct transfer and the ceiling.
    of = cells.loc[standings[0].methods.method.iloc[0], "here"]
    ends = [number(end) for end in shown[0].get_attribute("title").partition("[")[2].split(",")]
    assert ends == pytest.approx([100 * of.difference_low, 100 * of.difference_high], abs=0.051)
    shown[0].click()  # A phone has nothing to point with.
    said = browser.find_element("id", "tapped")
    assert said.text == f"{shown[0].text}: {shown[0].get_attribute('title')}"
    figure = browser.find_element("css selector", "#ranking tbody td [title]")
    figure.click()  # In any table.
    assert said.text == f"{figure.text}: {figure.get_attribute('title')}"
    browser.find_element("tag name", "h1").click()
    assert not said.is_displayed()
    (here,) = [x for x in browser.find_elements("css selector", "#methods th.condition") if x.text == "here"]
    assert here.get_attribute("title") == "ur3; outer reach"


def test_a_click_on_an_arm_shows_its_conditions_alone_and_the_address_keeps_it(opened):
    browser = opened()
    assert [x.text for x in browser.find_elements("css selector", "#arms button")] == ["all", "ur3", "ur5"]
    every = ranked(browser)
    press(browser, "arms", "ur3")
    few = ranked(browser)
    assert [{*every[name]} - {*few[name]} for name in every] == [{"there saturated"}] * 5
    assert all(few[name][title] == every[name][title] for name in few for title in few[name])
    assert browser.find_element("id", "told").text.startswith("1 of 2 conditions")
    assert browser.switch_to.active_element.text == "ur3"
    opened("#" + browser.current_url.partition("#")[2])
    assert ranked(browser) == few
    press(browser, "arms", "all")
    assert ranked(browser) == every


def test_conditions_are_shown_in_shares_and_another_suite_by_itself(opened, standings):
    browser = opened()
    points = ranked(browser)
    press(browser, "units", "percent of the head-room")
    for name, cells in [*ranked(browser).items()][:-2]:
        room = 100 - number(points["direct"]["here"])
        assert number(cells["here"]) == pytest.approx(100 * number(points[name]["here"]) / room, abs=0.3)
        assert cells["there saturated"] == "–" and cells["share"] == points[name]["share"]
    press(browser, "suites", "easy")
    shown = ranked(browser)
    assert {*shown["direct"]} == {"there", "needs"} and not browser.find_element("id", "units").is_displayed()
    assert [shown[name]["there"] for name in shown] == [points[name]["there saturated"] for name in shown]


def test_a_board_without_suites_begins_with_its_arms(browser, tables, tmp_path):
    (tmp_path / "page.html").write_text(page(BLOCK_PUSH, tables, tmp_path))
    browser.get((tmp_path / "page.html").as_uri())
    assert not browser.find_element("id", "best").is_displayed() and len(column(browser, "n")) == 7


def test_it_says_how_to_submit(opened):
    said = opened().find_element("id", "submit").text
    assert "benchmark.run suite=quick method=" in said and "benchmark.enter entry=" in said


@pytest.mark.parametrize("published", [False, True])
def test_print_holds_every_column_and_the_intervals(browser, file, published):
    """A4 on its long side, less margins of 10 mm, is 1047 points wide."""
    page = {"width": 1047, "height": 718, "deviceScaleFactor": 1, "mobile": False}
    browser.get((RESULTS / "leaderboard.html" if published else file).as_uri())
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", page)
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    try:
        ends = "return [...document.querySelectorAll('table')].map(x => x.getBoundingClientRect().right)"
        assert max(browser.execute_script(ends)) <= 1047
        between = browser.find_elements("css selector", "#methods .in-print")
        assert between and all(text.is_displayed() and text.text[0] == "[" for text in between)
        assert not browser.find_element("tag name", "form").is_displayed()
        assert not browser.find_element("id", "arms").is_displayed()
    finally:
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_the_papers_score_stands_beside_what_the_paper_ran_and_nothing_else(opened):
    browser = opened()
    script = """return [["direct", 0], ["paper", 0.5], ["paper", 2], ["towards", 0.5]].map(([method, lambda]) =>
      published({protocol: "paper", robot: "ur3", method, lambda})?.[0] ?? null)"""
    assert browser.execute_script(script) == [0.6464, 0.9134, None, None]


def test_a_click_on_a_title_sorts_and_another_one_turns_it_round(opened, tables):
    browser = opened()
    (title,) = [x for x in browser.find_elements("css selector", "#ranking th button") if x.text == "success at end"]
    title.click()
    falling = {part: [*map(first_number, texts)] for part, texts in groups(browser, "success at end").items()}
    assert falling == {part: sorted(values, reverse=True) for part, values in falling.items()}
    assert sum(map(len, falling.values())) == len(tables[STRICT])
    browser.switch_to.active_element.click()
    rising = {part: [*map(first_number, texts)] for part, texts in groups(browser, "success at end").items()}
    assert rising == {part: values[::-1] for part, values in falling.items()}
    assert browser.find_element("css selector", "th[aria-sort=ascending]").text.startswith("success at end")


def test_filters_narrow_everything_and_the_address_keeps_them(opened):
    browser = opened()
    choose(browser, "robot", "ur3")
    assert [*groups(browser, "n")] == [*groups(browser, "method", "mechanism")] == ["ur3, embodied"]
    browser.find_element("name", "text").send_keys("entry")
    assert column(browser, "method") == ["+pull-back entry"]
    assert browser.find_element("tag name", "output").text == "1 of 7 rows"
    assert len(browser.find_elements("css selector", "#causes .bar")) == 1
    opened("#" + browser.current_url.partition("#")[2])
    assert browser.find_element("tag name", "output").text == "1 of 7 rows"
    browser.find_element("css selector", "button[type=reset]").click()
    assert browser.find_element("tag name", "output").text == "7 of 7 rows"
    choose(browser, "method", "projection")
    choose(browser, "setting", "embodied")
    assert [*groups(browser, "n")] == ["ur3, embodied", "ur5, embodied"]


def test_a_row_opens_to_its_policies(opened, tables):
    browser = opened()
    button = browser.find_element("css selector", "#ranking tbody button")
    button.click()
    policies = browser.find_elements("css selector", "tr.policies tbody tr")
    assert [row.text.split()[0] for row in policies] == ["seed42-1", "seed43-1", "seed44-1"]
    shown = [first_number(row.find_elements("tag name", "td")[2].text) for row in policies]
    assert shown == pytest.approx([100 * policy["p2"] for policy in tables[STRICT].policies[0]], abs=0.051)
    button.click()
    assert not browser.find_elements("css selector", "tr.policies")


def test_the_keyboard_reaches_filters_titles_and_rows(opened):
    from selenium.webdriver.common.keys import Keys

    browser, reached = opened(), []
    for _ in range(50):
        browser.switch_to.active_element.send_keys(Keys.TAB)
        reached.append(browser.switch_to.active_element)
    named = [x.get_attribute("name") or x.get_attribute("aria-label") or x.text for x in reached]
    assert named[0] == "Which method gains most"
    named = named[[name.startswith("How to read it") for name in named].index(True) :]
    assert named[1:8] == ["mine", "easy", "all", "ur3", "ur5", "points", "percent of the head-room"]
    assert named[8] == "Which method gains most"
    assert ["protocol", "setting", "robot", "method", "text", "All", "Ranking", "method", "λ"] == named[9:18]
    assert "Policies of projection 0.01 on ur3, embodied" in named
    reached[named.index("success at end") - len(named)].send_keys(Keys.ENTER)
    assert browser.find_element("css selector", "th[aria-sort=descending]").text.startswith("success at end")


def covering(browser):
    """Names in the panels of curves that cover each other, and the names of each panel."""
    script = (
        "return [...arguments[0].querySelectorAll('svg text')].map(x => [x.textContent, x.getBoundingClientRect()])"
    )
    found, names = [], []
    for panel in browser.find_elements("css selector", "#curves figure"):
        boxes = browser.execute_script(script, panel)
        names.append({text for text, _ in boxes})
        for (one, a), (other, b) in itertools.combinations(boxes, 2):
            beside = a["right"] <= b["left"] or b["right"] <= a["left"]
            if not (beside or a["bottom"] <= b["top"] or b["bottom"] <= a["top"]):
                found.append((one, other))
    return found, names


def test_no_name_in_a_panel_covers_another(opened):
    found, names = covering(opened("#protocol=paper"))
    assert len(names) == 1 and not found


@pytest.mark.parametrize("protocol", ["paper", "strict"])
def test_no_name_in_a_published_panel_covers_another(browser, protocol):
    browser.get(f"{(RESULTS / 'leaderboard.html').as_uri()}#protocol={protocol}")
    found, names = covering(browser)
    assert browser.find_elements("id", "curves") and not found
    assert all(names)


def test_curves_are_drawn_where_a_method_has_several_scales(opened):
    browser = opened("#protocol=paper")
    (panel,) = browser.find_elements("css selector", "#curves figure")
    assert panel.text.startswith("ur3, original")
    assert len(panel.find_elements("css selector", "circle")) == 3  # Lambda 0, 0.5 and 1.
    assert "paper, direct" in panel.text and "paper, guided" in panel.text
    choose(browser, "protocol", "strict")
    assert "more than one scale" in browser.find_element("id", "curves").text


def test_bars_of_causes_are_as_long_as_their_share(opened, tables):
    browser = opened()
    bars = browser.find_elements("css selector", "#causes .bar")
    for bar, row in zip(bars, tables[STRICT].itertuples(), strict=True):
        parts = [part.rect["width"] for part in bar.find_elements("tag name", "i")]
        assert sum(parts) / bar.rect["width"] == pytest.approx(sum(row.causes.values()) / row.n, abs=0.01)


def test_moving_pictures_can_be_stopped(opened):
    browser = opened()
    image = browser.find_element("css selector", "#pictures img")
    assert image.get_attribute("alt") == "Episode: ur3, embodied, λ 0.5, 100000"
    assert browser.execute_script("return arguments[0].naturalWidth", image) == 40
    button = browser.find_element("css selector", "#pictures button")
    button.click()
    assert button.text == "Play" and not image.is_displayed()
    assert browser.find_element("css selector", "#pictures canvas").is_displayed()
    button.click()
    assert button.text == "Pause" and image.is_displayed()


def test_another_way_of_standing_is_a_table_of_its_own(browser, tables, tmp_path):
    """It is another task: its figures are not sorted among those of the usual way."""
    moved = tables[STRICT][tables[STRICT].robot == "ur3"].assign(orientation_weight=0.01, p2=1.0)
    file = tmp_path / "moved.html"
    file.write_text(page(BLOCK_PUSH, {STRICT: pd.concat([moved, tables[STRICT]])}, tmp_path))
    browser.get(file.as_uri())
    assert [*groups(browser, "n")] == ["ur3, embodied", "ur5, embodied", "ur3, embodied, orientation weight 0.01"]


def test_titles_say_what_they_mean(opened):
    browser = opened()
    for title in browser.find_elements("css selector", "#ranking th button"):
        assert len(title.get_attribute("title")) > 20, title.text


def test_a_phone_shows_the_page_in_its_width(opened):
    browser = opened()
    phone = {"width": 390, "height": 844, "deviceScaleFactor": 2, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", phone)
    try:
        for view in ("", "#protocol=paper"):
            opened(view)
            browser.find_element("tag name", "summary").click()
            assert browser.execute_script("return [innerWidth, document.documentElement.scrollWidth]") == [390, 390]
            scrolls = "return [...document.querySelectorAll('.scroll')].map(x => [x.clientWidth, x.scrollWidth])"
            assert all(seen < 390 < whole for seen, whole in browser.execute_script(scrolls))
            check_ranking_on_a_phone(browser)
            assert min(bar.rect["width"] for bar in browser.find_elements("css selector", "#causes .bar")) > 250
            parts = browser.find_elements("css selector", "#causes *, figure, form *")
            assert max(part.rect["x"] + part.rect["width"] for part in parts) <= 390
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def check_ranking_on_a_phone(browser):
    """Methods keep their names beside the conditions, and every button can be pressed by a finger."""
    scrolled = "arguments[0].scrollLeft = arguments[0].scrollWidth; return arguments[0].scrollLeft"
    area = browser.find_element("css selector", ".scroll:has(#methods)")
    assert browser.execute_script(scrolled, area) > 0
    left = "return [...document.querySelectorAll('#methods .name')].map(x => x.getBoundingClientRect().left)"
    assert {*browser.execute_script(left)} == {area.rect["x"] + 1}
    buttons = [x.rect for x in browser.find_elements("css selector", ".choices button")]
    assert all(each["x"] + each["width"] <= 390 and each["height"] >= 32 for each in buttons)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_texts_stand_out_in_light_and_dark(opened, scheme):
    browser = opened()
    media = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
    ground = luminance(browser.find_element("tag name", "body").value_of_css_property("background-color"))
    assert (ground > 0.5) == (scheme == "light")
    for text in ("h1", ".soft", "th button", "td", "td .soft", "output", "select", ".entry", "[aria-pressed=true]"):
        ink = luminance(browser.find_element("css selector", text).value_of_css_property("color"))
        dark, light = sorted((ink, ground))
        assert (light + 0.05) / (dark + 0.05) >= 4.5, text  # WCAG 2.2, level AA.


def luminance(colour):
    """Relative luminance of rgb(r, g, b), as WCAG defines it."""
    channels = np.array([int(x) for x in re.findall(r"\d+", colour)[:3]]) / 255
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    return float(linear @ (0.2126, 0.7152, 0.0722))
