"""A browser of the distribution, for the tests that look at pages."""

import os
import shutil
import subprocess

import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome")


def usable_browser() -> str | None:
    """A browser of the distribution that runs here; on some, the package is only a pointer to another store."""
    for name in BROWSERS:
        found = shutil.which(name)
        if found is None:
            continue
        answer = subprocess.run([found, "--version"], capture_output=True, text=True, timeout=60, check=False)
        if answer.returncode == 0 and "Chrom" in answer.stdout:
            return found
    return None


@pytest.fixture(scope="module")
def browser():
    found = usable_browser()
    if found is None:
        pytest.skip(f"no browser: none of {', '.join(BROWSERS)} runs here; apt-get install chromium brings one")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        # the sandbox of Chromium does not work for root
        browser = playwright.chromium.launch(executable_path=found, chromium_sandbox=os.geteuid() != 0)
        yield browser
        browser.close()
