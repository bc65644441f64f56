"""The rules of axe-core on what keeps people from reading and using a page: contrast, names and roles."""

import pathlib

from playwright.sync_api import Page

AXE = pathlib.Path(__file__).parent / "node_modules/axe-core/axe.min.js"


def violations(page: Page) -> dict[str, list[str]]:
    """The elements of a page that break a rule, by the rule's name; none where axe-core is not installed."""
    if not AXE.exists():
        return {}
    page.evaluate(AXE.read_text(encoding="utf-8"))
    found = page.evaluate("axe.run()")["violations"]
    return {one["id"]: [node["html"][:120] for node in one["nodes"]] for one in found}
