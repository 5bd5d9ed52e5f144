"""The live page: what its server sends, to whom, and what it takes; and what it shows of a joint."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import socket
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from pam_antagonist.errors import BadInput

pytest.importorskip("tornado")

from tornado.httpclient import AsyncHTTPClient, HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

from pam_antagonist.nodes import watch_server
from pam_antagonist.nodes.watch_server import Server, names_this_machine

PAGE = Path(watch_server.__file__).with_name("watch.html")


class Joint:
    """What a page shows, without ROS."""

    def __init__(self) -> None:
        self.listening: list[bool] = []
        self.orders: list[dict[str, Any]] = []

    def listen(self, wanted: bool) -> None:
        self.listening.append(wanted)

    def frame(self) -> list[float | None]:
        return [1.0, 0.1, None]

    def report(self) -> dict[str, Any]:
        return {"rig": "shin2022"}

    def command(self, order: dict[str, Any]) -> None:
        if order.get("do") == "nonsense":
            raise BadInput("expected reference, enable or clear_stop")
        self.orders.append(order)


VISITS: list[Any] = []
"""Connections of a scene, which end with it."""
Scene = Callable[[Joint, Server, str], Awaitable[None]]


def play(scene: Scene, commands: bool = False) -> Joint:
    """A server on a free port; the scene gets its address without the key."""

    async def whole() -> Joint:
        joint = Joint()
        server = Server(joint, port=0, commands=commands)
        try:
            await asyncio.wait_for(scene(joint, server, server.address.partition("#")[0]), 30.0)
        finally:
            while VISITS:
                VISITS.pop().close()
            for _ in range(500):
                if not server.pages:
                    break
                await asyncio.sleep(0.01)
            server.stop()
            await server._http.close_all_connections()
        return joint

    return asyncio.run(whole())


def live(address: str, **headers: str) -> HTTPRequest:
    return HTTPRequest(address.replace("http", "ws") + "live", headers=headers)


async def visit(request: HTTPRequest) -> Any:
    VISITS.append(await websocket_connect(request))
    return VISITS[-1]


async def refused(address: str, **headers: str) -> int:
    try:
        await visit(live(address, **headers))
    except HTTPClientError as error:
        return error.code
    return 0


def test_it_sends_thirty_frames_a_second_and_a_report_now_and_then() -> None:
    async def scene(joint: Joint, server: Server, address: str) -> None:
        page = await visit(live(address, Origin=address.rstrip("/")))
        loop = asyncio.get_running_loop()
        first = json.loads(await page.read_message())
        assert first["frame"] == [1.0, 0.1, None]
        assert first["report"] == {"rig": "shin2022", "commands": False}
        begin = loop.time()
        contents = [json.loads(await page.read_message()) for _ in range(45)]
        took = loop.time() - begin
        assert 1.3 < took < 10.0  # 1.5 s, and more on a busy machine
        assert sum("report" in content for content in contents) == 3

    assert play(scene).listening == [True, False]


@pytest.mark.parametrize("origin", ["http://evil.example", "http://127.0.0.1:1", "https://{host}", "null", "file://"])
def test_another_page_in_the_same_browser_cannot_read_it(origin: str) -> None:
    """Nor one whose name points here (DNS rebinding): then Origin and Host agree, and both are somebody else's."""

    async def scene(joint: Joint, server: Server, address: str) -> None:
        host = address.removeprefix("http://").rstrip("/")
        assert await refused(address, Origin=origin.format(host=host)) == 403
        port = host.rpartition(":")[2]
        assert await refused(address, Origin=f"http://evil.example:{port}", Host=f"evil.example:{port}") == 403
        with pytest.raises(HTTPClientError, match="403"):
            await AsyncHTTPClient().fetch(HTTPRequest(address, headers={"Host": "evil.example"}))
        assert joint.listening == []
        assert await refused(address, Origin=address.rstrip("/")) == 0

    assert play(scene).listening[0] is True


@pytest.mark.parametrize(
    ("host", "good"),
    [
        *((host, True) for host in ("localhost", "127.0.0.1", "[::1]", "192.168.0.7", socket.gethostname())),
        *((host, False) for host in ("localhost.evil.example", "")),
    ],
)
def test_names_of_this_machine(host: str, good: bool) -> None:
    assert names_this_machine(host) is good


async def answer_of(page: Any) -> str:
    while True:
        content = json.loads(await page.read_message())
        if "refused" in content:
            return str(content["refused"])


def test_it_takes_no_command_unless_it_is_told_to_and_gets_the_key_that_was_printed() -> None:
    async def read_only(joint: Joint, server: Server, address: str) -> None:
        page = await visit(live(address))
        await page.write_message(json.dumps({"do": "clear_stop", "key": ""}))
        assert await answer_of(page) == "read-only: start watch with --allow-commands"

    assert play(read_only).orders == []

    async def scene(joint: Joint, server: Server, address: str) -> None:
        page = await visit(live(address))
        for order in ({"do": "clear_stop"}, {"do": "clear_stop", "key": "x"}, {"do": "clear_stop", "key": None}):
            await page.write_message(json.dumps(order))
            assert await answer_of(page) == "a command: expected the key of the address that watch printed"
        for text in ("[]", "nonsense", "[" * 500):
            await page.write_message(text)
            assert await answer_of(page) == "a command: expected JSON"
        key = server.address.partition("#")[2]
        assert len(key) > 15
        await page.write_message(json.dumps({"do": "nonsense", "key": key}))
        assert await answer_of(page) == "expected reference, enable or clear_stop"
        await page.write_message(json.dumps({"do": "enable", "value": True, "key": key}))
        while not joint.orders:
            await page.read_message()

    assert [order["do"] for order in play(scene, commands=True).orders] == ["enable"]


def test_a_page_too_many_is_refused() -> None:
    async def scene(joint: Joint, server: Server, address: str) -> None:
        pages = [await visit(live(address)) for _ in range(8)]
        assert await refused(address) == 503
        assert len(pages) == len(server.pages)

    play(scene)


def test_the_page_may_load_and_reach_nothing_else() -> None:
    async def scene(joint: Joint, server: Server, address: str) -> None:
        answer = await AsyncHTTPClient().fetch(address)
        assert answer.code == 200 and answer.body.decode() == PAGE.read_text()
        policy = answer.headers["Content-Security-Policy"]
        assert "default-src 'none'" in policy and "connect-src 'self'" in policy and "frame-ancestors 'none'" in policy
        assert "script-src 'sha256-" in policy
        assert answer.headers["Cache-Control"] == "no-store"

    assert play(scene).listening == [], "nothing is subscribed while nobody looks"
    text = PAGE.read_text()
    assert not re.findall(r"(?:src|href)=|https?://(?!www\.w3\.org)", text.replace('"https:"', ""))
    assert text.count("<script>") == 1 and " onclick=" not in text


def test_a_port_that_is_taken_is_said_in_one_line() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]

        async def start() -> None:
            with pytest.raises(BadInput, match=f"^cannot listen on 127.0.0.1, port {port}: "):
                Server(Joint(), port=port)

        asyncio.run(start())


# ------------------------------------------------------------------ with ROS


@pytest.mark.ros
def test_the_page_and_the_frames_name_the_same_fields() -> None:
    from pam_antagonist.nodes.watch import FIELDS

    (listed,) = re.findall(r"const FIELDS = \[(.*?)\];", PAGE.read_text(), re.DOTALL)
    assert tuple(re.findall(r'"(\w+)"', listed)) == FIELDS


@pytest.mark.ros
@pytest.mark.realtime
def test_frames_show_what_the_joint_publishes(domain: None) -> None:
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    from probe import Probe

    from pam_antagonist.nodes import qos
    from pam_antagonist.nodes.references import ASKED, MODE, STIFFNESS
    from pam_antagonist.nodes.watch import FIELDS, PipelineWatch

    watch = PipelineWatch()
    with contextlib.closing(watch):
        assert watch.look().startswith("no joint in namespace /pam of ROS domain ")
        assert watch.report()["absent"] == watch.absent
        with Probe() as probe:
            assert not watch._topics and watch.frame()[1:] == [None] * (len(FIELDS) - 1)
            names = ("joint_estimate", "pressure_1", "valve_state", "measured_joint_states", "reference")
            for name in names:
                assert not probe.matched(name)
            watch.listen(True)
            health = probe.node.create_publisher(DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)
            probe.until(lambda: all(map(probe.matched, names)) and health.get_subscription_count() > 0, 20.0, "a page")
            assert watch.look() == "" and watch.report()["absent"] == ""
            estimate = probe.publisher("joint_estimate").msg_type(angle=0.2, torque=1.5, nis=2.0, stiffness=6.0)
            estimate.external_torque, estimate.external_torque_covariance[3] = 0.3, 0.04
            estimate.covariance[0], estimate.covariance[8] = 0.0004, 0.01
            messages = {
                "joint_estimate": estimate,
                "pressure_1": probe.publisher("pressure_1").msg_type(fluid_pressure=4e5),
                "valve_state": probe.publisher("valve_state").msg_type(voltage=[5.0, 6.0]),
                "measured_joint_states": probe.publisher("measured_joint_states").msg_type(
                    name=["joint"], position=[0.21], effort=[float("nan")]
                ),
            }
            values = [KeyValue(key=MODE, value="impedance"), KeyValue(key=ASKED, value="0.25")]
            values.append(KeyValue(key=STIFFNESS, value="5.0"))
            statuses = [
                DiagnosticStatus(name="pam/controller: commands", level=b"\x02", message="stopped"),
                DiagnosticStatus(name="pam/controller: reference", level=b"\x00", message="followed", values=values),
                DiagnosticStatus(name="other/controller: commands", level=b"\x00", message="of another joint"),
            ]
            frame: dict[str, float | None] = {}

            def shown() -> bool:
                for name, message in messages.items():
                    probe.publisher(name).publish(message)
                health.publish(DiagnosticArray(status=statuses))
                frame.update(zip(FIELDS, watch.frame(), strict=True))
                return None not in (frame["angle"], frame["pressure_1"], frame["encoder"], frame["reference_angle"])

            probe.until(shown, 20.0, "a whole frame")
            assert frame["angle"] == 0.2 and frame["angle_std"] == pytest.approx(0.02) and frame["nis"] == 2.0
            assert frame["torque_std"] == pytest.approx(0.1) and frame["pressure_1"] == 4e5
            assert (frame["voltage_1"], frame["voltage_2"]) == (5.0, 6.0)
            assert frame["encoder"] == 0.21 and frame["torque_meter"] is None and frame["pressure_2"] is None
            assert frame["reference_angle"] == 0.25 and frame["reference_torque"] is None
            status, reference = watch.report()["statuses"]
            assert (frame["stiffness"], frame["reference_stiffness"]) == (6.0, 5.0)
            assert frame["external_torque"] == 0.3 and frame["external_torque_std"] == pytest.approx(0.2)
            assert reference["name"] == "controller: reference"
            assert reference["values"] == {MODE: "impedance", ASKED: "0.25", STIFFNESS: "5.0"}
            torques = probe.publisher("reference").msg_type(mode=3, value=1.0, stiffness=4.0)

            def asked() -> bool:
                probe.publisher("reference").publish(torques)
                frame.update(zip(FIELDS, watch.frame(), strict=True))
                return frame["reference_torque"] is not None

            probe.until(asked, 20.0, "a reference of torque and stiffness")
            assert frame["reference_stiffness"] == 4.0 and frame["reference_angle"] is None
            assert (status["name"], status["level"], status["text"]) == ("controller: commands", 2, "stopped")
            json.dumps(watch.report(), allow_nan=False)
            probe.wait(0.2)
            watch.frame()  # takes what was still on its way
            probe.wait(0.5)
            assert dict(zip(FIELDS, watch.frame(), strict=True))["angle"] is None  # too old to be shown
            watch.listen(False)
            probe.until(lambda: not any(map(probe.matched, names)), 20.0, "the end of the subscriptions")


@pytest.mark.ros
def test_commands_are_checked_and_carried_out(domain: None) -> None:
    from probe import Probe
    from rclpy.executors import SingleThreadedExecutor
    from std_srvs.srv import SetBool

    from pam_antagonist.nodes.watch import PipelineWatch

    with contextlib.closing(PipelineWatch()) as reader, pytest.raises(BadInput, match="read-only"):
        reader.command({"do": "clear_stop"})
    with contextlib.closing(PipelineWatch(commands=True)) as watch:
        with Probe("reference") as probe:
            for order, why in (
                ({"do": "reference", "mode": "angle", "value": float("inf")}, "finite"),
                ({"do": "reference", "mode": "angle", "value": True}, "a number"),
                ({"do": "reference", "mode": "speed", "value": 1.0}, "a mode"),
                ({"do": "enable", "value": 1}, "true or false"),
                ({"do": "enable", "value": True}, "the node is not there"),
                ({"do": ["open"]}, "expected reference"),
            ):
                with pytest.raises(BadInput, match=why):
                    watch.command(order)

            def arrived() -> bool:
                watch.command({"do": "reference", "mode": "torque", "value": 1.25})
                return bool(probe.seen["reference"])

            probe.until(arrived, 20.0, "a reference")
            message = probe.seen["reference"][0][1]
            assert (message.mode, message.value) == (1, 1.25) and message.header.stamp.sec > 0

            asked: list[bool] = []

            def enable(request: Any, response: Any) -> Any:
                asked.append(request.data)
                response.message = "disabled: silent"
                return response

            probe.node.create_service(SetBool, "controller/enable", enable)
            executor = SingleThreadedExecutor(context=probe.node.context)
            executor.add_node(probe.node)
            probe.until(watch._enable.service_is_ready, 20.0, "the service")
            watch.command({"do": "enable", "value": False})

            def answered() -> bool:
                executor.spin_once(0.0)
                watch.frame()
                return bool(watch._answers)

            probe.until(answered, 20.0, "an answer")
            assert asked == [False] and watch.report()["answers"] == ["controller: disable: disabled: silent"]
            executor.shutdown()


@pytest.mark.ros
def test_the_page_shows_the_step_of_a_command_until_it_ends(domain: None, monkeypatch: pytest.MonkeyPatch) -> None:
    from pam_antagonist.nodes import watch
    from pam_antagonist.nodes.client import Announcer

    monkeypatch.setattr(watch, "_GONE", 1.5)

    def report(wanted: str) -> dict[str, Any]:
        deadline = time.monotonic() + 20.0
        while time.monotonic() < deadline:
            page.frame()
            found = page.report()
            if (bool(wanted) and re.search(wanted, found["at"][0])) if found["at"] else not wanted:
                return found
            time.sleep(0.05)
        raise AssertionError(f"the page never showed {wanted!r}")

    with contextlib.closing(watch.PipelineWatch()) as page:
        page.listen(True)
        with Announcer("commission") as announcer:
            begun = time.monotonic()
            announcer.say("step 2 of 7, free: driving the joint", 40.0)
            found = report(r"step 2 of 7, free: driving the joint, [1-9]\d* of 40 s")  # the first one may be seen late
            said = re.search(r", (\d+) of 40 s", found["at"][0])
            assert said and 1 <= int(said[1]) <= round(time.monotonic() - begun)
            begun = time.monotonic()
            announcer.say("step 4 of 7, identify: working")
            found = report(r"step 4 of 7, identify: working, \d+ s")
            said = re.search(r"working, (\d+) s", found["at"][0])
            assert said and int(said[1]) <= round(time.monotonic() - begun)
            (status,) = found["statuses"]
            assert status["name"] == "commission: step" and status["level"] == 0
        assert report("")["statuses"] == [], "a command that has ended is no fault"
