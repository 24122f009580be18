"""The bond with a lifecycle manager, and calls of the map server, with stand-ins for ROS."""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from segloc_ros import bond_port
from segloc_ros.bond_port import BondPort
from segloc_ros.core.maps import grid_beside
from segloc_ros.grid_port import GridPort


class Side:
    """A node whose topics and timer are lists; time is set."""

    def __init__(self) -> None:
        self.sent: dict[str, list[tuple[str, bool]]] = {}
        self.heard: dict[str, Any] = {}
        self.beat: Any = None

    def get_name(self) -> str:
        return "segloc"

    def get_logger(self) -> Any:
        return SimpleNamespace(warning=lambda text: None)

    def get_clock(self) -> Any:
        return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: None))

    def create_publisher(self, kind: Any, topic: str, depth: int) -> Any:
        sent = self.sent.setdefault(topic, [])
        return SimpleNamespace(
            publish=lambda m: sent.append((m.instance_id, m.active)),
            wait_for_all_acked=lambda timeout: True,
        )

    def create_subscription(self, kind: Any, topic: str, heard: Any, depth: int) -> Any:
        self.heard[topic] = heard

    def create_timer(self, period_s: float, beat: Any, clock: Any) -> None:
        assert period_s < 1.0
        self.beat = beat

    def destroy_timer(self, timer: Any) -> None:
        self.beat = None

    destroy_subscription = destroy_publisher = lambda self, end: None


def status(id: str = "segloc", instance_id: str = "manager", active: bool = True) -> Any:
    return SimpleNamespace(
        id=id, instance_id=instance_id, active=active, header=SimpleNamespace(stamp=None)
    )


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    clock = SimpleNamespace(now=100.0)
    message = SimpleNamespace(Status=status)
    monkeypatch.setitem(sys.modules, "bond", SimpleNamespace(msg=message))
    monkeypatch.setitem(sys.modules, "bond.msg", message)
    monkeypatch.setitem(sys.modules, "rclpy", SimpleNamespace())
    monkeypatch.setitem(
        sys.modules, "rclpy.duration", SimpleNamespace(Duration=lambda seconds: None)
    )
    monkeypatch.setattr(bond_port.time, "monotonic", lambda: clock.now)
    return clock


@pytest.mark.parametrize("topic", ["bond", "bond/segloc"])
def test_a_bond_lives_while_both_ends_do(clock: SimpleNamespace, topic: str) -> None:
    side = Side()
    port = BondPort(side, None)
    sent = side.sent[topic]
    for _ in range(100):  # the manager comes late
        clock.now += 0.25
        side.beat()
    for instance, active in sent:
        side.heard[topic](status(instance_id=instance, active=active))  # its own come back
    side.heard[topic](status(id="amcl", active=False))
    for _ in range(40):
        clock.now += 0.25
        side.heard[topic](status())
        side.beat()
    assert len(sent) == 140 and all(active for _, active in sent)
    assert len({instance for instance, _ in sent}) == 1
    side.heard[topic](status(instance_id="another", active=False))
    side.beat()
    assert sent[-1][1]
    port.close()
    assert not sent[-1][1] and side.beat is None


def test_a_manager_that_ends_or_falls_silent_breaks_the_bond(clock: SimpleNamespace) -> None:
    side = Side()
    BondPort(side, None)
    side.heard["bond"](status())
    side.heard["bond"](status(active=False))
    assert [active for _, active in side.sent["bond"]] == [False]  # acknowledged
    side.beat()
    assert len(side.sent["bond"]) == 1
    silent = Side()
    BondPort(silent, None)
    silent.heard["bond"](status())
    clock.now += 3.9
    silent.beat()
    clock.now += 0.2
    silent.beat()
    assert len(silent.sent["bond"]) == 1


def test_the_grid_beside_a_map_is_found(tmp_path: Path) -> None:
    map_yaml, site_yaml = tmp_path / "site" / "map.yaml", tmp_path / "site.yaml"
    for name in ("site.segmap", "site.pcd", "site"):
        assert grid_beside(str(tmp_path / name)) == ""
    site_yaml.touch()
    assert grid_beside(str(tmp_path / "site.segmap")) == str(site_yaml)
    map_yaml.parent.mkdir()
    map_yaml.touch()
    for name in ("site.segmap", "site.pcd", "site"):
        assert grid_beside(str(tmp_path / name)) == str(map_yaml)
    assert grid_beside(str(tmp_path / "other.segmap")) == ""
    assert grid_beside("https://maps.example/site") == ""


@pytest.mark.parametrize(
    ("ready", "result", "told"),
    [(True, 0, "site.yaml loaded"), (True, 2, "returned result 2"), (False, 0, "no service")],
)
def test_the_map_server_is_called(
    monkeypatch: pytest.MonkeyPatch, ready: bool, result: int, told: str
) -> None:
    kind = SimpleNamespace(Request=SimpleNamespace, Response=SimpleNamespace(RESULT_SUCCESS=0))
    monkeypatch.setitem(sys.modules, "nav2_msgs", SimpleNamespace())
    monkeypatch.setitem(sys.modules, "nav2_msgs.srv", SimpleNamespace(LoadMap=kind))
    called: list[str] = []
    log: list[str] = []

    def call_async(request: Any) -> Any:
        called.append(request.map_url)
        done = SimpleNamespace(result=lambda: SimpleNamespace(result=result))
        return SimpleNamespace(add_done_callback=lambda callback: callback(done))

    client = SimpleNamespace(service_is_ready=lambda: ready, call_async=call_async)
    logger = SimpleNamespace(info=log.append, warning=log.append, error=log.append)
    node = SimpleNamespace(create_client=lambda kind, service: client, get_logger=lambda: logger)
    GridPort(node, "map_server/load_map").load("/maps/site.yaml")
    assert called == ["/maps/site.yaml"] * ready and len(log) == 1 and told in log[0]
