"""What keeps people from reading and using a page: contrast, names and roles, by axe-core's rules; and contents that move."""

import pathlib

from playwright.sync_api import Page

STEADY = 0.1
"""A page whose layout shift stays below this is called good by Lighthouse and its kin."""

WATCH_SHIFTS = """
  window.layoutShifts = [];
  new PerformanceObserver((list) => window.layoutShifts.push(...list.getEntries()
    .filter(({ hadRecentInput }) => !hadRecentInput)
    .map(({ startTime, value, sources }) => {
      return { startTime, value, moved: sources.map(({ node }) => node?.id || node?.nodeName) };
    }))).observe({ type: "layout-shift", buffered: true });
"""
"""A script that a page runs before its own: it notes what moves although nobody has just pressed or clicked anything."""

AXE = pathlib.Path(__file__).parent / "node_modules/axe-core/axe.min.js"


def violations(page: Page) -> dict[str, list[str]]:
    """The elements of a page that break a rule, by the rule's name; none where axe-core is not installed."""
    if not AXE.exists():
        return {}
    page.evaluate(AXE.read_text(encoding="utf-8"))
    found = page.evaluate("axe.run()")["violations"]
    return {one["id"]: [node["html"][:120] for node in one["nodes"]] for one in found}


def restless(page: Page) -> list[dict]:
    """The shifts of a page with WATCH_SHIFTS, if those within 5 s come to more than STEADY; each with what it moved."""
    shifts = page.evaluate("window.layoutShifts")
    for last in shifts:
        near = [one for one in shifts if last["startTime"] - 5000 <= one["startTime"] <= last["startTime"]]
        if sum(one["value"] for one in near) >= STEADY:
            return near
    return []
