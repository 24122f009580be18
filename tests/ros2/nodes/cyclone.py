"""A robot without ROS: Cyclone DDS, with the messages written down by hand from their definitions.

python cyclone.py CLOUDS    # walks, and prints each pose on /initialpose with the truth, as JSON

Nothing of it is shared with the node: neither the middleware, nor the code that makes bytes of
messages.
"""

# No `from __future__ import annotations`: the types of the fields are read as they stand.
import json
import os
import sys
import time
from dataclasses import dataclass
from typing import Any

# 1.15 is eProsima, whose descriptions of types Cyclone need not compare with its own.
os.environ["CYCLONEDDS_URI"] = """<CycloneDDS><Domain>
  <General>
    <Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>
    <AllowMulticast>false</AllowMulticast>
  </General>
  <Discovery><ParticipantIndex>auto</ParticipantIndex>
    <MaxAutoParticipantIndex>60</MaxAutoParticipantIndex>
    <Peers><Peer Address="127.0.0.1"/></Peers></Discovery>
  <Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>
</Domain></CycloneDDS>"""

import numpy as np
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float64, int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from samples.plaza import Plaza
from samples.ros_drive import MOUNT
from samples.streams import walked
from scipy.spatial.transform import Rotation

from segloc import geometry


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class PointField(IdlStruct, typename="sensor_msgs::msg::dds_::PointField_"):
    name: str
    offset: uint32
    datatype: uint8
    count: uint32


@dataclass
class PointCloud2(IdlStruct, typename="sensor_msgs::msg::dds_::PointCloud2_"):
    header: Header
    height: uint32
    width: uint32
    fields: sequence[PointField]
    is_bigendian: bool
    point_step: uint32
    row_step: uint32
    data: sequence[uint8]
    is_dense: bool


@dataclass
class Vector(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Vector
    orientation: Quaternion


@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovariance_"):
    pose: Pose
    covariance: array[float64, 36]


@dataclass
class Twist(IdlStruct, typename="geometry_msgs::msg::dds_::Twist_"):
    linear: Vector
    angular: Vector


@dataclass
class TwistWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::TwistWithCovariance_"):
    twist: Twist
    covariance: array[float64, 36]


@dataclass
class Odometry(IdlStruct, typename="nav_msgs::msg::dds_::Odometry_"):
    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


@dataclass
class Stamped(IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovarianceStamped_"):
    header: Header
    pose: PoseWithCovariance


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"):
    header: Header
    child_frame_id: str
    translation: Vector
    rotation: Quaternion


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    transforms: sequence[TransformStamped]


RELIABLE = Policy.Reliability.Reliable(duration(seconds=10))
USUAL = Qos(RELIABLE, Policy.History.KeepLast(50))
LATCHED = Qos(RELIABLE, Policy.History.KeepLast(1), Policy.Durability.TransientLocal)


def header(stamp: float, frame: str) -> Header:
    sec = int(stamp)
    return Header(Time(sec, round(1e9 * (stamp - sec)) % 10**9), frame)


def parts(T: np.ndarray) -> tuple[Vector, Quaternion]:
    q = Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
    return Vector(*T[:3, 3].tolist()), Quaternion(*q)


def odometry(stamp: float, T: np.ndarray) -> Odometry:
    nothing, still = [0.0] * 36, Twist(Vector(0.0, 0.0, 0.0), Vector(0.0, 0.0, 0.0))
    pose = PoseWithCovariance(Pose(*parts(T)), nothing)
    return Odometry(header(stamp, "odom"), "base_link", pose, TwistWithCovariance(still, nothing))


def cloud(stamp: float, points: np.ndarray) -> PointCloud2:
    fields = [PointField(name, 4 * k, 7, 1) for k, name in enumerate("xyz")]
    data = np.ascontiguousarray(points, dtype="<f4").tobytes()
    return PointCloud2(
        header(stamp, "/os_sensor"), 1, len(points), fields, False, 12, 12 * len(points), data, True
    )


def main(count: int) -> None:
    participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))

    def writer(name: str, kind: Any, qos: Qos = USUAL) -> DataWriter:
        return DataWriter(participant, Topic(participant, f"rt/{name}", kind), qos)

    points, odom = writer("points", PointCloud2), writer("odom", Odometry)
    tf = writer("tf_static", TFMessage, LATCHED)
    heard = DataReader(participant, Topic(participant, "rt/initialpose", Stamped), USUAL)
    end = time.monotonic() + 60.0
    while not all(w.get_matched_subscriptions() for w in (points, odom, tf)):
        assert time.monotonic() < end, "no subscriptions"
        time.sleep(0.1)
    tf.write(TFMessage([TransformStamped(header(0.0, "base_link"), "/os_sensor", *parts(MOUNT))]))
    lidar_base, truths = geometry.inverse(MOUNT), {}
    for events, truth in walked(Plaza(0), count, start_s=500.0):
        for event in events:
            if event.scan is None:
                odom.write(odometry(event.stamp, event.T_odom_base @ lidar_base))
            else:
                points.write(cloud(event.stamp, event.scan.points))
                truths[event.stamp] = (truth @ lidar_base)[:3, 3].tolist()
            time.sleep(0.3)
    time.sleep(3.0)
    for message in heard.take(50):
        stamp, at = message.header.stamp, message.pose.pose.position
        seconds = stamp.sec + 1e-9 * stamp.nanosec
        told = {"frame": message.header.frame_id, "covariance": list(message.pose.covariance)}
        print(json.dumps(told | {"at": [at.x, at.y, at.z], "truth": truths.get(seconds)}))


if __name__ == "__main__":
    main(int(sys.argv[1]))
