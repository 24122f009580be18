"""The grid of Nav2's map server follows the map."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rclpy.node import Node


class GridPort:
    """Calls ``load_map`` of Nav2's map server; raise ImportError if nav2_msgs is not installed."""

    def __init__(self, node: Node, service: str) -> None:
        from nav2_msgs.srv import LoadMap

        self._type, self._node, self._service = LoadMap, node, service
        self._client = node.create_client(LoadMap, service)

    def load(self, grid: str) -> None:
        """Load a map.yaml; the log has the result."""
        if not self._client.service_is_ready():
            self._node.get_logger().warning(
                f"grid {grid} not loaded: no service {self._service}; start the map server, or set "
                "grid_service"
            )
            return
        call = self._client.call_async(self._type.Request(map_url=grid))
        call.add_done_callback(lambda done: self._log(grid, done.result()))

    def _log(self, grid: str, response: Any) -> None:
        logger, result = self._node.get_logger(), int(response.result)
        if result == self._type.Response.RESULT_SUCCESS:
            logger.info(f"grid {grid} loaded by {self._service}")
        else:
            logger.error(f"grid {grid} not loaded: {self._service} returned result {result}")

    def close(self) -> None:
        """End it."""
        self._node.destroy_client(self._client)
