"""A ROS 2 node for a tactile sensor: WrenchStamped, a force field as PointCloud2, and events as String.

Run it where ROS 2 is sourced (rclpy, geometry_msgs, sensor_msgs, std_msgs):

    python tactile_node.py --pad pad.toml --camera 0 --state state.h5 --frame gel

Topics: ``tactile/wrench``, ``tactile/field`` and ``tactile/events``. Forces act on the pad, in the frame of the pad:
its origin at the centre of the surface, z out of it; the force on the object is the negative. The loop of the sensor
runs in threads of its own; this node takes its newest frame and publishes it.
"""

from __future__ import annotations

import argparse
import threading
from typing import Any

import rclpy
from geometry_msgs.msg import Vector3, WrenchStamped
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import String

from tactile.live import Live, LiveFrame, point_cloud, start, wrench


class TactileNode(Node):
    """Publishes the frames of a running sensor."""

    def __init__(self, live: Live, frame: str) -> None:
        super().__init__("tactile")
        self.live, self.frame = live, frame
        self.wrench = self.create_publisher(WrenchStamped, "tactile/wrench", qos_profile_sensor_data)
        self.field = self.create_publisher(PointCloud2, "tactile/field", qos_profile_sensor_data)
        self.events = self.create_publisher(String, "tactile/events", 10)
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _run(self) -> None:
        for frame in self.live:
            self.publish(frame)

    def publish(self, frame: LiveFrame) -> None:
        """The messages of one frame, with the time at which the camera gave it."""
        stamped = WrenchStamped()
        seconds, part = divmod(frame.time, 1)
        stamped.header.stamp.sec, stamped.header.stamp.nanosec = int(seconds), int(1e9 * part)
        stamped.header.frame_id = self.frame
        told = wrench(frame.map)
        stamped.wrench.force, stamped.wrench.torque = Vector3(**told["force"]), Vector3(**told["torque"])
        self.wrench.publish(stamped)
        fields: dict[str, Any] = point_cloud(frame.map)
        fields["fields"] = [PointField(**field) for field in fields["fields"]]
        self.field.publish(PointCloud2(header=stamped.header, **fields))
        for event in frame.events:
            self.events.publish(String(data=str(event)))


def main() -> None:
    """Run until it is interrupted."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pad", required=True)
    parser.add_argument("--camera", required=True)
    parser.add_argument("--state")
    parser.add_argument("--frame", default="gel")
    given = parser.parse_args()
    camera = int(given.camera) if given.camera.isdecimal() else given.camera
    live = start(given.pad, camera, state=given.state)
    rclpy.init()
    node = TactileNode(live, given.frame)
    try:
        rclpy.spin(node)
    finally:
        live.close()
        node.destroy_node()
        rclpy.shutdown()


if __name__ == "__main__":
    main()
