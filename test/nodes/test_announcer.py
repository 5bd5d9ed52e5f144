"""What a command is at comes to the live page, and goes when the command ends."""

from __future__ import annotations

import time

import pytest

pytestmark = [pytest.mark.ros]


def test_the_page_shows_the_step_and_how_far_it_is(domain: None, monkeypatch: pytest.MonkeyPatch) -> None:
    from pam_antagonist.nodes import watch
    from pam_antagonist.nodes.client import Announcer

    monkeypatch.setattr(watch, "_GONE", 1.5)
    page = watch.PipelineWatch()
    page.listen(True)

    def report(wanted: str) -> dict[str, object]:
        deadline = time.monotonic() + 20.0
        while time.monotonic() < deadline:
            page.frame()
            at = page.report()["at"]
            if (bool(wanted) and wanted in at[0]) if at else not wanted:
                return page.report()
            time.sleep(0.05)
        raise AssertionError(f"the page never showed {wanted!r}")

    try:
        with Announcer("commission") as announcer:
            announcer.say("step 2 of 7, free: driving the joint", 40.0)
            report("step 2 of 7, free: driving the joint, 1 of 40 s")
            announcer.say("step 4 of 7, identify: working")
            (status,) = report("step 4 of 7, identify: working, 0 s")["statuses"]
            assert status["name"] == "commission: step" and status["level"] == 0
        assert report("")["statuses"] == [], "a command that has ended is no fault"
    finally:
        page.close()
