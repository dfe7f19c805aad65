#!/usr/bin/python3
"""Writes data in the forms of LAMP and of the NeBula multi-robot data set, with the independent writers of
python3-rosbag and Python's own zipfile, and expected.json with the values that a reader must find.

    lamp_data.py FORM FOLDER [--compression none|bz2|lz4] [--robots c,e] [--nodes N] [--points N] [--options ...]

FORM is one of: probe (does nothing, fails where a module is absent), bags, base, split, odd, factors, g2o_pcd,
lamp_zip, sessions, big. The messages are made from the definitions below: no ROS packages are needed.
"""
import argparse
import json
import math
import os
import random
import struct
import sys
import zipfile

HEADER = "uint32 seq\ntime stamp\nstring frame_id\n"
POINT = "float64 x\nfloat64 y\nfloat64 z\n"
QUATERNION = "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
POSE = "Point position\nQuaternion orientation\n"
FIELD = """# A field of the points
uint8 INT8    = 1
uint8 UINT8   = 2
uint8 INT16   = 3
uint8 UINT16  = 4
uint8 INT32   = 5
uint8 UINT32  = 6
uint8 FLOAT32 = 7
uint8 FLOAT64 = 8
string name      # Name of field
uint32 offset    # Offset from start of point struct
uint8  datatype  # Datatype enumeration, see above
uint32 count     # How many elements in the field
"""
CLOUD = """Header header
uint32 height
uint32 width
PointField[] fields
bool    is_bigendian # Is this data bigendian?
uint32  point_step   # Length of a point in bytes
uint32  row_step     # Length of a row in bytes
uint8[] data         # Actual point data, size is (row_step*height)
bool is_dense
"""
NODE = "Header header\nuint64 key\nstring ID\ngeometry_msgs/Pose pose\nfloat64[36] covariance\n"
EDGE = """int32 ODOM = 0
int32 PRIOR = 1
int32 IMU = 2
int32 LOOPCLOSE = 3
int32 ARTIFACT = 4
int32 UWB_RANGE = 5
int32 UWB_BETWEEN = 6
uint64 key_from
uint64 key_to
int32 type
geometry_msgs/Pose pose
float64[36] covariance
float64 range
float64 range_error
"""
GRAPH = "Header header\nbool incremental\nPoseGraphNode[] nodes\nPoseGraphEdge[] edges\n"
COMM_INFO = "string hostname\nstring uwb_id\nstring robot_name\nuint64 pose_graph_key\ngeometry_msgs/Pose relative_pose\n"
COMM_STATUS = "Header header\nCommNodeInfo[] remaining\nCommNodeInfo[] dropped\n"
NEIGHBOR = """int32 my_node_id
string my_node_label
string my_robot_name
uint64 my_pg_key
int32 my_noise_level_dBm
int32 my_interference_dB
int32 my_txpw_actual_mW
float32 my_txpw_actual_dBm
int32 neighbor_node_id
string neighbor_node_label
uint64 neighbor_pg_key
string color
int32 queue_size
int32 snr_dB
float32 total_air_time_percent
float32 total_data_rate_Mbps
float32 loss_rate_percent
float32 theoretical_udp_throughput_Mbps
int32 num_spatial_streams
int32[] received_signal_power_dBm
int32 link_adaptation_modulation_coding_scheme
int32 guard_interval_mode
int32 cyclic_prefix_length
"""
# Shorter than the radios' definition: a reader has to use the definition in the bag.
SILVUS_NODE = """int32 node_id
string node_label
string robot_name
uint64 pg_key
int32 last_updated_s
string gateway_ip
string ipaddr
string netmask
SilvusStreamscapeNeighbor[] neighbors
int32 frag_thresh_bytes
int32 beam_form_enable
string board_type
key_value_int32_int32[] next_hop
float32 forward_multicast_rate_Mbps
"""
KEY_VALUE = "int32 key\nint32 value\n"
SILVUS = """Header header
string robot_namespace
string target_radio
int32 streamscape_sequence_number
SilvusStreamscapeNode[] nodes
"""
ODOMETRY = "Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\ngeometry_msgs/TwistWithCovariance twist\n"

BASE = {"std_msgs/Header": HEADER, "geometry_msgs/Point": POINT, "geometry_msgs/Quaternion": QUATERNION,
        "geometry_msgs/Pose": POSE}
TYPES = {
    "pose_graph_msgs/KeyedScan": ("uint64 key\nsensor_msgs/PointCloud2 scan\n", {
        "sensor_msgs/PointCloud2": CLOUD, "std_msgs/Header": HEADER, "sensor_msgs/PointField": FIELD}),
    "pose_graph_msgs/PoseGraph": (GRAPH, {
        **BASE, "pose_graph_msgs/PoseGraphNode": NODE, "pose_graph_msgs/PoseGraphEdge": EDGE}),
    "pose_graph_msgs/CommNodeStatus": (COMM_STATUS, {**BASE, "pose_graph_msgs/CommNodeInfo": COMM_INFO}),
    "silvus_msgs/SilvusStreamscape": (SILVUS, {
        "std_msgs/Header": HEADER, "silvus_msgs/SilvusStreamscapeNode": SILVUS_NODE,
        "silvus_msgs/SilvusStreamscapeNeighbor": NEIGHBOR, "silvus_msgs/key_value_int32_int32": KEY_VALUE}),
    "nav_msgs/Odometry": (ODOMETRY, {
        **BASE, "geometry_msgs/PoseWithCovariance": "Pose pose\nfloat64[36] covariance\n",
        "geometry_msgs/TwistWithCovariance": "Twist twist\nfloat64[36] covariance\n",
        "geometry_msgs/Twist": "Vector3 linear\nVector3 angular\n",
        "geometry_msgs/Vector3": POINT}),
}
CLASSES = {}


def message_class(name, part=None):
    """A message class of a root type, or of a type of its fields."""
    if name not in CLASSES:
        from genpy.dynamic import generate_dynamic
        own, used = TYPES[name]
        text = own
        for other, definition in used.items():
            text += "=" * 80 + "\nMSG: " + other + "\n" + definition
        CLASSES[name] = generate_dynamic(name, text)
    return CLASSES[name][part or name]


def full_key(character, index):
    return (ord(character) << 56) + index


ROBOT_NAMES = {"a": "husky1", "b": "husky2", "c": "husky3", "d": "husky4", "e": "spot1", "f": "spot2"}
START = 1600000000
INTERVAL = 2


def multiply(a, b):
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (aw * bx + ax * bw + ay * bz - az * by, aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw, aw * bw - ax * bx - ay * by - az * bz)


def rotate(q, v):
    x, y, z, _ = multiply(multiply(q, (*v, 0.0)), (-q[0], -q[1], -q[2], q[3]))
    return (x, y, z)


def unit(q):
    n = math.sqrt(sum(v * v for v in q))
    return tuple(v / n for v in q)


def between(a, b):
    """T_a_b of two poses (x y z qx qy qz qw)."""
    inverse = (-a[3], -a[4], -a[5], a[6])
    t = rotate(inverse, tuple(b[i] - a[i] for i in range(3)))
    return t + unit(multiply(inverse, tuple(b[3:7])))


def pose_on_path(robot, i, offset=0.0):
    n = ord(robot) - ord("a")
    yaw = 0.05 * i + 0.3 * n
    tilt = 0.02 * math.sin(i + n)
    q = unit(multiply((0, 0, math.sin(yaw / 2), math.cos(yaw / 2)), (math.sin(tilt / 2), 0, 0, math.cos(tilt / 2))))
    return (2.0 * i * math.cos(0.025 * i) + 100.0 * n + offset, 1.5 * math.sin(0.1 * i), 0.01 * i * n, *q)


def covariance(rng, rotation_sigma, translation_sigma, correlated):
    """36 numbers, rotation first, symmetric and positive definite."""
    sigmas = [rotation_sigma * (1 + 0.1 * k) for k in range(3)] + [translation_sigma * (1 + 0.2 * k) for k in range(3)]
    out = [[0.0] * 6 for _ in range(6)]
    for i in range(6):
        for j in range(6):
            rho = 1.0 if i == j else (0.1 / (1 + abs(i - j)) if correlated else 0.0)
            out[i][j] = rho * sigmas[i] * sigmas[j]
    return [out[i][j] for i in range(6) for j in range(6)]


def to_float(value):
    return struct.unpack("<f", struct.pack("<f", value))[0]


def make_points(rng, count, normals):
    points = []
    for _ in range(count):
        p = [to_float(rng.uniform(-20, 20)) for _ in range(3)]
        intensity = to_float(rng.uniform(0, 255))
        n = []
        if normals:
            # Towards the sensor, of unit length.
            length = math.sqrt(sum(v * v for v in p))
            n = [to_float(-v / length) for v in p]
        points.append((p, intensity, n))
    return points


# ---- PointCloud2 in several layouts ----

def cloud_message(points, layout, normals):
    cls = message_class("pose_graph_msgs/KeyedScan", "sensor_msgs/PointCloud2")
    field_class = message_class("pose_graph_msgs/KeyedScan", "sensor_msgs/PointField")
    order = "<"
    if layout == "pcl":  # what PCL's toROSMsg makes: padding after x y z, intensity at 16
        names = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7)]
        if normals:
            names += [("normal_x", 16, 7), ("normal_y", 20, 7), ("normal_z", 24, 7), ("intensity", 32, 7),
                      ("curvature", 36, 7)]
            step = 48
        else:
            names += [("intensity", 16, 7)]
            step = 32
    elif layout == "odd":  # any order, doubles, a byte before and an array between
        names = [("flag", 0, 2), ("z", 1, 8), ("intensity", 9, 7), ("extra", 13, 3), ("y", 19, 8), ("x", 27, 8)]
        if normals:
            names += [("normal_x", 35, 7), ("normal_z", 39, 7), ("normal_y", 43, 7)]
        step = 51
    elif layout == "big":  # of a big-endian machine
        order = ">"
        names = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("intensity", 12, 7)]
        if normals:
            names += [("normal_x", 16, 7), ("normal_y", 20, 7), ("normal_z", 24, 7)]
        step = 28
    elif layout == "rows":  # two rows with room at the end of each
        names = [("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("intensity", 12, 7)]
        if normals:
            names += [("normal_x", 16, 7), ("normal_y", 20, 7), ("normal_z", 24, 7)]
        step = 28
    m = cls()
    for name, offset, kind in names:
        m.fields.append(field_class(name=name, offset=offset, datatype=kind, count=3 if name == "extra" else 1))
    letter = {2: "B", 3: "h", 7: "f", 8: "d"}
    raw = []
    for p, intensity, n in points:
        values = {"x": p[0], "y": p[1], "z": p[2], "intensity": intensity, "curvature": 0.5, "flag": 7, "extra": -3}
        if normals:
            values.update(normal_x=n[0], normal_y=n[1], normal_z=n[2])
        point = bytearray(b"\xab" * step)
        for name, offset, kind in names:
            struct.pack_into(order + letter[kind], point, offset, values[name])
        raw.append(bytes(point))
    m.height = 2 if layout == "rows" else 1
    m.width = len(points) // m.height
    m.point_step = step
    m.row_step = m.width * step + (13 if layout == "rows" else 0)
    m.is_bigendian = order == ">"
    m.is_dense = True
    if layout == "rows":
        half = m.width
        m.data = b"".join(raw[:half]) + b"\x00" * 13 + b"".join(raw[half:2 * half]) + b"\x00" * 13
    else:
        m.data = b"".join(raw)
    return m


# ---- A recording ----

class Recording:
    """The motion of the robots, as the expected result and as messages."""

    def __init__(self, robots, nodes, points, seed=1, normals=False, layouts=("pcl",)):
        self.rng = random.Random(seed)
        self.robots = robots
        self.nodes = []  # (key, stamp_ns, pose)
        self.edges = []  # (from, to, type, pose, covariance)
        self.priors = []
        self.scans = {}
        self.truth = {}
        self.normals = normals
        self.layouts = layouts
        for n, robot in enumerate(robots):
            for i in range(nodes):
                key = full_key(robot, i)
                stamp = (START + INTERVAL * i) * 10**9 + 1000 * n + 17
                pose = pose_on_path(robot, i)
                self.nodes.append((key, stamp, pose))
                if i == 0:
                    self.priors.append((key, pose, covariance(self.rng, 0.01, 0.0016, False)))
                else:
                    correlated = i % 2 == 1
                    self.edges.append((key - 1, key, 0, between(pose_on_path(robot, i - 1), pose),
                                       covariance(self.rng, 0.003, 0.02, correlated)))
                self.scans[key] = make_points(self.rng, points, normals)
                self.truth[key] = pose_on_path(robot, i, 0.25)

    def layout(self, key):
        return self.layouts[key % len(self.layouts)]

    def expected(self, **more):
        out = {
            "nodes": [{"key": str(k), "stamp_ns": str(s), "pose": p} for k, s, p in self.nodes],
            "edges": [{"from": str(a), "to": str(b), "type": t, "pose": p, "covariance": c}
                      for a, b, t, p, c in self.edges],
            "priors": [{"key": str(k), "pose": p, "covariance": c} for k, p, c in self.priors],
            "scans": {str(k): {"points": [p for p, _, _ in s], "intensities": [i for _, i, _ in s],
                               "normals": [n for _, _, n in s] if self.normals else []}
                      for k, s in self.scans.items()},
            "truth": {str(k): p for k, p in self.truth.items()},
            "names": [ROBOT_NAMES[r] for r in self.robots],
        }
        out.update(more)
        return out


def ros_time(ns):
    import genpy
    return genpy.Time(ns // 10**9, ns % 10**9)


def set_pose(message, pose):
    message.position.x, message.position.y, message.position.z = pose[:3]
    o = message.orientation
    o.x, o.y, o.z, o.w = pose[3:]


def graph_message(nodes, edges, stamp):
    cls = message_class("pose_graph_msgs/PoseGraph")
    node_class = message_class("pose_graph_msgs/PoseGraph", "pose_graph_msgs/PoseGraphNode")
    edge_class = message_class("pose_graph_msgs/PoseGraph", "pose_graph_msgs/PoseGraphEdge")
    m = cls()
    m.header.stamp = ros_time(stamp)
    m.header.frame_id = "world"
    for key, stamp_ns, pose, name in nodes:
        node = node_class(key=key, ID=name)
        node.header.stamp = ros_time(stamp_ns)
        set_pose(node.pose, pose)
        m.nodes.append(node)
    for a, b, kind, pose, cov, distance, error in edges:
        edge = edge_class(key_from=a, key_to=b, type=kind, range=distance, range_error=error)
        set_pose(edge.pose, pose)
        edge.covariance = list(cov)
        m.edges.append(edge)
    return m


def incremental_messages(recording, robot, with_prior=True):
    """One message per new node, with its edge; the first is sent twice, as in recordings."""
    out = []
    for key, stamp, pose in recording.nodes:
        if key >> 56 != ord(robot):
            continue
        edges = [(a, b, t, p, c, 0.0, 0.0) for a, b, t, p, c in recording.edges if b == key]
        if with_prior:
            edges += [(k, k, 1, p, c, 0.0, 0.0) for k, p, c in recording.priors if k == key]
        message = graph_message([(key, stamp, pose, "odom_node")], edges, stamp)
        out.append((stamp, message))
        if not out[1:]:
            out.append((stamp + 5, message))
    return out


def scan_message(recording, key):
    cls = message_class("pose_graph_msgs/KeyedScan")
    return cls(key=key, scan=cloud_message(recording.scans[key], recording.layout(key), recording.normals))


def odometry_message(stamp, pose):
    m = message_class("nav_msgs/Odometry")()
    m.header.stamp = ros_time(stamp)
    m.header.frame_id = "world"
    m.child_frame_id = "base_link"
    set_pose(m.pose.pose, pose)
    return m


def open_bag(path, compression="none", chunk=768 * 1024):
    import rosbag
    os.makedirs(os.path.dirname(path) or ".", exist_ok=True)
    return rosbag.Bag(path, "w", compression=compression, chunk_threshold=chunk)


def write_robot_bag(path, recording, robot, compression, chunk=768 * 1024, select=lambda number: True):
    """The robot's two topics. Scans of odd nodes come before their node, the others after."""
    name = ROBOT_NAMES[robot]
    messages = [(s, "lamp/pose_graph_incremental", m) for s, m in incremental_messages(recording, robot)]
    for key, stamp, _ in recording.nodes:
        if key >> 56 == ord(robot):
            messages.append((stamp + (-3 if key % 2 else 3), "lamp/keyed_scans", scan_message(recording, key)))
    messages.sort(key=lambda entry: entry[0])
    with open_bag(path, compression, chunk) as bag:
        for number, (stamp, topic, message) in enumerate(messages):
            if select(number):
                bag.write("/" + name + "/" + topic, message, ros_time(stamp))
    return len(messages)


def write_truth_bag(path, recording, robot, compression="none"):
    """True poses at 10 Hz about each node's stamp: the nearest is 20 ms off, and its pose is the node's."""
    name = ROBOT_NAMES[robot]
    with open_bag(path, compression) as bag:
        for key, stamp, _ in recording.nodes:
            if key >> 56 != ord(robot):
                continue
            pose = recording.truth[key]
            for step in range(-3, 4):
                at = stamp + step * 100_000_000 + 20_000_000
                moved = (pose[0] + 0.1 * step, *pose[1:])
                bag.write("/" + name + "/lo_frontend/odometry", odometry_message(at, moved), ros_time(at + 500))


def save_expected(folder, expected):
    with open(os.path.join(folder, "expected.json"), "w", encoding="utf-8") as out:
        json.dump(expected, out)


# ---- Forms ----

def make_bags(o):
    recording = Recording(o.robots, o.nodes, o.points, o.seed, layouts=("pcl", "odd", "big", "rows"))
    for robot in o.robots:
        write_robot_bag(os.path.join(o.folder, "rosbag", ROBOT_NAMES[robot] + ".bag"), recording, robot, o.compression,
                        o.chunk)
        write_truth_bag(os.path.join(o.folder, "ground_truth", ROBOT_NAMES[robot] + "_odom.bag"), recording, robot)
    save_expected(o.folder, recording.expected())


def make_split(o):
    """Two parts of one robot's recording, the messages of both interleaved in time."""
    recording = Recording(o.robots[:1], o.nodes, o.points, o.seed)
    robot = o.robots[0]
    for part in range(2):
        write_robot_bag(os.path.join(o.folder, "rosbag", "%s_%d.bag" % (ROBOT_NAMES[robot], part)), recording, robot,
                        o.compression, o.chunk, lambda number, part=part: number // 3 % 2 == part)
    save_expected(o.folder, recording.expected())


def make_base(o):
    """A base station's bag: whole graphs again and again, scans with normals, closures, all other factors, radio."""
    recording = Recording(o.robots, o.nodes, o.points, o.seed, normals=True)
    first, second = o.robots[0], o.robots[1]
    closure = (full_key(first, 3), full_key(second, 1), 3,
               between(pose_on_path(first, 3), pose_on_path(second, 1)), covariance(recording.rng, 0.02, 0.1, True))
    artifact = full_key(first.upper(), 0)
    anchor = full_key("u", 0)
    start = START * 10**9
    with open_bag(os.path.join(o.folder, "base1.bag"), o.compression, o.chunk) as bag:
        for n in range(2, o.nodes + 1):
            stamp = start + INTERVAL * n * 10**9
            known = [(k, s, p, "odom_node") for k, s, p in recording.nodes if (k & 0xffffffff) < n]
            keys = {k for k, _, _, _ in known}
            edges = [(a, b, t, p, c, 0.0, 0.0) for a, b, t, p, c in recording.edges if b in keys]
            edges += [(k, k, 1, p, c, 0.0, 0.0) for k, p, c in recording.priors]
            if n == o.nodes:
                edges.append((*closure, 0.4, 0.0)[:5] + (0.0, 0.4))
                known.append((artifact, stamp, (1, 2, 3, 0, 0, 0, 1), "uuid-artifact"))
                known.append((anchor, 0, (4, 5, 6, 0, 0, 0, 1), "uuid-anchor"))
                edges.append((full_key(first, 1), artifact, 4, (1, 0, 0, 0, 0, 0, 1),
                              covariance(recording.rng, 1.0, 0.1, False), 0.0, 0.0))
                edges.append((full_key(first, 1), anchor, 5, (0, 0, 0, 0, 0, 0, 0), [0.0] * 36, 7.5, 0.3))
                edges.append((full_key(first, 2), full_key(first, 2), 2, (0, 0, -1, 0, 0, 0, 1),
                              [0.05] + [0.0] * 35, 0.0, 0.0))
                edges.append((full_key(first, 2), full_key(first, 3), 8, (0, 0, 0, 0, 0, 0, 1), [0.0] * 36, 0.0, 0.0))
            bag.write("/base1/lamp/pose_graph", graph_message(known, edges, stamp), ros_time(stamp))
            # Messages of the optimiser have other poses, no stamps, and no poses of edges.
            moved = [(k, 0, (p[0] + 0.1 * n, *p[1:]), m) for k, _, p, m in known]
            bare = [(a, b, t, (0,) * 7, [0.0] * 36, 0.0, 0.0) for a, b, t, _, _, _, _ in edges if t in (0, 3)]
            bag.write("/base1/lamp_pgo/optimized_values", graph_message(moved, bare, 0), ros_time(stamp + 100))
        for key, stamp, _ in recording.nodes:
            bag.write("/base1/lamp/keyed_scans", scan_message(recording, key), ros_time(stamp + 10**8))
        status = message_class("pose_graph_msgs/CommNodeStatus")
        info = message_class("pose_graph_msgs/CommNodeStatus", "pose_graph_msgs/CommNodeInfo")
        for k in range(3):
            m = status()
            m.header.stamp = ros_time(start + (4 + k) * 10**9)
            m.dropped.append(info(hostname="scom-" + ROBOT_NAMES[first], robot_name=ROBOT_NAMES[first]))
            if k > 0:
                m.dropped.append(info(hostname="beacon7", robot_name=ROBOT_NAMES[first],
                                      pose_graph_key=full_key(first, 2)))
            if k > 1:
                m.dropped.append(info(hostname="lost", robot_name="x", pose_graph_key=full_key("f", 9)))
            bag.write("/base1/comm_node_manager/status_agg", m, ros_time(start + (4 + k) * 10**9 + 50))
        radio = message_class("silvus_msgs/SilvusStreamscape")
        radio_node = message_class("silvus_msgs/SilvusStreamscape", "silvus_msgs/SilvusStreamscapeNode")
        neighbor = message_class("silvus_msgs/SilvusStreamscape", "silvus_msgs/SilvusStreamscapeNeighbor")
        for at, power in ((6.1, -25), (6.9, -33), (8.05, -60)):
            m = radio()
            stamp = start + int(at * 1000) * 10**6
            m.header.stamp = ros_time(stamp)
            heard = neighbor(my_txpw_actual_dBm=28.5, neighbor_node_label="beacon7",
                             received_signal_power_dBm=[power, power - 2])
            other = neighbor(my_txpw_actual_dBm=28.5, neighbor_node_label="scom-spot9",
                             received_signal_power_dBm=[-1, -1])
            unknown = neighbor(my_txpw_actual_dBm=28.5, neighbor_node_label="beacon8",
                               received_signal_power_dBm=[-50])
            m.nodes.append(radio_node(node_label="scom-" + ROBOT_NAMES[first], neighbors=[heard, other, unknown]))
            m.nodes.append(radio_node(node_label="beacon7", neighbors=[other]))
            bag.write("/base1/comm/silvus/raw", m, ros_time(stamp + 70))
    # Names come from the robots' own topics.
    for robot in o.robots:
        with open_bag(os.path.join(o.folder, ROBOT_NAMES[robot] + ".bag"), o.compression) as bag:
            for stamp, message in incremental_messages(recording, robot)[:1]:
                bag.write("/" + ROBOT_NAMES[robot] + "/lamp/pose_graph_incremental", message, ros_time(stamp - 1000))
    recording.truth = {}
    expected = recording.expected(closure={"from": str(closure[0]), "to": str(closure[1]), "pose": closure[3],
                                           "covariance": closure[4]})
    save_expected(o.folder, expected)


def make_odd(o):
    """Faulty messages, which a reader must leave out and report."""
    recording = Recording(o.robots[:1], 6, o.points, o.seed)
    robot = o.robots[0]
    name = ROBOT_NAMES[robot]
    zero = [0.0] * 36
    swapped = covariance(recording.rng, 0.05, 0.002, False)  # sigmas of 0.05 rad and 2 mm: the halves are exchanged
    keys = [full_key(robot, i) for i in range(6)]
    nodes = [(k, s, p, "odom_node") for k, s, p in recording.nodes]
    poses = [p for _, _, p in recording.nodes]
    nodes[3] = (keys[3], 0, poses[3], "odom_node")
    nodes.append((full_key(robot, 6), 0, (0,) * 7, "odom_node"))
    edge = lambda i, cov, pose=None: (keys[i], keys[i + 1], 0, pose or between(poses[i], poses[i + 1]), cov, 0.0, 0.0)
    nan = float("nan")
    edges = [edge(0, zero), edge(1, swapped), edge(2, [-1.0] * 36), edge(3, swapped, (nan, 0, 0, 0, 0, 0, 1)),
             (keys[0], keys[2], 0, between(poses[0], poses[2]), covariance(recording.rng, 0.003, 0.02, False), 0., 0.),
             (keys[0], keys[0], 3, poses[0], covariance(recording.rng, 0.003, 0.02, False), 0.0, 0.0),
             (keys[0], full_key("f", 77), 3, poses[0], zero, 0.0, 0.0)]
    with open_bag(os.path.join(o.folder, "odd.bag"), o.compression) as bag:
        topic = "/" + name + "/lamp/pose_graph_incremental"
        stamp = START * 10**9
        bag.write(topic, graph_message(nodes, edges, stamp), ros_time(stamp))
        changed = [(a, b, t, p, covariance(recording.rng, 0.004, 0.02, False), 0.0, 0.0)
                   for a, b, t, p, _, _, _ in edges[:2]]
        bag.write(topic, graph_message([], changed, stamp), ros_time(stamp + 10))
        for i in range(5):
            message = scan_message(recording, keys[i])
            if i == 1:
                message.scan.data = message.scan.data[:-5]
            if i == 2:
                message.scan.fields = message.scan.fields[1:]
            if i == 3:
                message.scan.point_step = 15
            bag.write("/" + name + "/lamp/keyed_scans", message, ros_time(stamp + 100 + i))
            if i == 0:
                bag.write("/" + name + "/lamp/keyed_scans", message, ros_time(stamp + 101))
        bag.write("/" + name + "/lo_frontend/odometry", odometry_message(stamp, poses[0]), ros_time(stamp))
    save_expected(o.folder, recording.expected())


def diagonal(rotation_sigma, translation_sigma):
    return [(rotation_sigma if i < 3 else translation_sigma)**2 if i == j else 0.0 for i in range(6) for j in range(6)]


def make_factors(o):
    """Ranges, gravity, artifacts and radio anchors, with the optimum that follows from them by hand.

    Robot c and anchor u0 are on one line, along which odometry, a sighting and a range disagree by 0.3 m: each gets its
    share by variance. Only ranges of robot e constrain anchor u1, and only positions constrain artifact E0; both have a
    wrong first pose. Robot a begins tilted and measures gravity. u2 has one range, u3 a prior, E1 no node.
    """
    zero = [0.0] * 36
    unset = (0.0,) * 7
    at = lambda x, y, z, yaw=0.0: (x, y, z, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
    moved = lambda pose, x, y, z: tuple(pose[k] + rotate(pose[3:], (x, y, z))[k] for k in range(3)) + pose[3:]
    key = full_key
    nodes, edges, optimum = [], [], {}

    line = at(30.0, -5.0, 2.0, 0.7)
    sigma_odometry, sigma_between, sigma_range = 0.1, 0.2, 0.05
    nodes += [(key("c", 0), line), (key("c", 1), moved(line, 4, 0, 0))]
    edges += [(key("c", 0), key("c", 0), 1, line, diagonal(0.01, 0.01), 0.0, 0.0),
              (key("c", 0), key("c", 1), 0, at(4, 0, 0), diagonal(0.01, sigma_odometry), 0.0, 0.0),
              (key("c", 0), key("u", 0), 6, at(10, 0, 0), diagonal(0.1, sigma_between), 0.0, 0.0),
              (key("c", 1), key("u", 0), 5, unset, zero, 6.3, sigma_range)]
    share = (10 - 4 - 6.3) / (sigma_odometry**2 + sigma_between**2 + sigma_range**2)
    optimum[key("c", 1)] = moved(line, 4 + share * sigma_odometry**2, 0, 0)
    optimum[key("u", 0)] = moved(line, 10 - share * sigma_between**2, 0, 0)

    places = [(0, 0, 0), (2, 0, 0.5), (3, 2, 1), (2, 4, 0), (0, 5, 1.5), (-2, 3, 0.3)]
    path = [at(*place, 0.3 * i) for i, place in enumerate(places)]
    anchor, known, artifact, other = (1.0, 2.0, 6.0), (-4.0, 2.0, 1.0), (5.0, 3.0, 0.5), (2.0, -3.0, 1.0)
    nodes += [(key("e", i), pose) for i, pose in enumerate(path)]
    edges.append((key("e", 0), key("e", 0), 1, path[0], diagonal(0.01, 0.01), 0.0, 0.0))
    seen_at = lambda i, place: rotate((-path[i][3], -path[i][4], -path[i][5], path[i][6]),
                                      tuple(place[k] - path[i][k] for k in range(3)))
    for i in range(6):
        if i > 0:
            edges.append((key("e", i - 1), key("e", i), 0, between(path[i - 1], path[i]), diagonal(0.003, 0.02), 0.0, 0.0))
        edges.append((key("e", i), key("u", 1), 5, unset, zero, math.dist(places[i], anchor), 0.0 if i == 5 else 0.01))
        # LAMP gives the position of an artifact, and a rotation without information.
        if i in (1, 3):
            edges.append((key("e", i), key("E", 0), 4, at(*seen_at(i, artifact)), diagonal(1e5, 0.1), 0.0, 0.0))
        if i in (2, 4):
            edges.append((key("e", i), key("E", 1), 4, at(*seen_at(i, other)), zero, 0.0, 0.0))
        if i in (0, 3):
            edges.append((key("e", i), key("u", 3), 5, unset, zero, math.dist(places[i], known), 0.1))
        optimum[key("e", i)] = path[i]
    edges.append((key("u", 3), key("u", 3), 1, at(*known), diagonal(1.0, 0.01), 0.0, 0.0))
    optimum[key("u", 1)], optimum[key("u", 3)] = at(*anchor), at(*known)
    optimum[key("E", 0)], optimum[key("E", 1)] = at(*artifact), at(*other)

    tilt, sigma_tilt, sigma_gravity = 0.2, 0.5, 0.1
    about_x = lambda angle: (-20.0, 0.0, 0.0, math.sin(angle / 2), 0.0, 0.0, math.cos(angle / 2))
    nodes.append((key("a", 0), about_x(tilt)))
    edges += [(key("a", 0), key("a", 0), 1, about_x(tilt), diagonal(sigma_tilt, 0.1), 0.0, 0.0),
              (key("a", 0), key("a", 0), 2, (0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0), [sigma_gravity] + [0.0] * 35, 0.0, 0.0)]
    low, high = 0.0, tilt  # of the derivative of the cost
    for _ in range(100):
        middle = 0.5 * (low + high)
        if (middle - tilt) / sigma_tilt**2 + math.sin(middle) / sigma_gravity**2 > 0:
            high = middle
        else:
            low = middle
    optimum[key("a", 0)] = about_x(low)

    # Factors that cannot be used.
    bad_range = lambda i, value, sigma: (key("e", i), key("c", 0), 5, unset, zero, value, sigma)
    bad_gravity = lambda i, x, y, z, sigma: (key("e", i), key("e", i), 2, (x, y, z, 0, 0, 0, 1), [sigma] + [0.0] * 35, 0., 0.)
    edges += [bad_range(0, -1.0, 0.1), bad_range(1, 5.0, -0.1), bad_range(2, float("nan"), 0.1),
              (key("e", 0), key("e", 0), 5, unset, zero, 0.0, 0.1), (key("e", 0), key("d", 5), 5, unset, zero, 3.0, 0.1),
              (key("c", 1), key("u", 2), 5, unset, zero, 7.0, 0.1),
              bad_gravity(0, 0, 0, 0, 0.1), bad_gravity(1, 0, 0, 1, 0.1), bad_gravity(2, 0, 0, -1, float("nan"))]

    recording = Recording([], 0, 0, o.seed)
    start = START * 10**9
    recording.nodes = [(k, start + i * INTERVAL * 10**9, p) for i, (k, p) in enumerate(nodes)]
    recording.scans = {k: make_points(recording.rng, o.points, False) for k, _, _ in recording.nodes}
    landmarks = [(key("u", 0), 0, moved(line, 10, 0, 0), "uuid-u0"), (key("u", 1), start + 3600 * 10**9, at(2, 1, 5), "uuid-u1"),
                 (key("u", 2), 0, at(9, 9, 9), "uuid-u2"), (key("u", 3), 0, at(*known), "uuid-u3"),
                 (key("E", 0), start + 1, at(6, 3, 0), "uuid-E0")]
    graph = [(k, s, p, "odom_node") for k, s, p in recording.nodes]
    with open_bag(os.path.join(o.folder, "factors.bag"), o.compression) as bag:
        bag.write("/base1/lamp/pose_graph", graph_message(graph + landmarks, edges, start), ros_time(start))
        again = [(key("c", 1), key("u", 0), 5, unset, zero, 9.9, 0.1), edges[0]]
        bag.write("/base1/lamp/pose_graph", graph_message(graph, again, start), ros_time(start + 1))
        for k, stamp, _ in recording.nodes:
            bag.write("/base1/lamp/keyed_scans", scan_message(recording, k), ros_time(stamp))
    save_expected(o.folder, {"optimum": {str(k): p for k, p in optimum.items()},
                             "nodes": [{"key": str(k), "stamp_ns": str(s), "pose": p} for k, s, p in recording.nodes]})


def g2o_pose(pose):
    return " ".join(repr(float(v)) for v in pose)


def information_triangle(cov):
    """Only diagonal covariances: inverted, with the translation first."""
    order = [3, 4, 5, 0, 1, 2]
    out = []
    for i in range(6):
        for j in range(i, 6):
            out.append(repr(1.0 / cov[7 * order[i]]) if i == j else "0")
    return " ".join(out)


def write_g2o(path, recording, rename=lambda key: key, closures=()):
    with open(path, "w", encoding="utf-8") as out:
        for key, _, pose in recording.nodes:
            out.write("VERTEX_SE3:QUAT %d %s\n" % (rename(key), g2o_pose(pose)))
        for a, b, _, pose, cov in list(recording.edges) + list(closures):
            out.write("EDGE_SE3:QUAT %d %d %s %s\n" % (rename(a), rename(b), g2o_pose(pose), information_triangle(cov)))


def pcd_bytes(points, normals, form):
    fields = ["x", "y", "z", "intensity"] + (["normal_x", "normal_y", "normal_z"] if normals else [])
    n = len(fields)
    rows = [[*p, i, *nn] for p, i, nn in points]
    head = "# .PCD v0.7\nVERSION 0.7\nFIELDS %s\nSIZE%s\nTYPE%s\nCOUNT%s\nWIDTH %d\nHEIGHT 1\n" \
           "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS %d\nDATA %s\n" % (
               " ".join(fields), " 4" * n, " F" * n, " 1" * n, len(rows), len(rows), form)
    if form == "ascii":
        body = "".join(" ".join(repr(v) for v in row) + "\n" for row in rows).encode()
    else:
        body = b"".join(struct.pack("<%df" % n, *row) for row in rows)
    return head.encode() + body


def make_g2o_pcd(o):
    recording = Recording(o.robots, o.nodes, o.points, o.seed, normals=o.normals)
    for e, edge in enumerate(recording.edges):  # diagonal, so that the information is known to the last digit
        recording.edges[e] = (*edge[:4], covariance(recording.rng, 0.003, 0.02, False))
    folder = o.folder
    os.makedirs(folder, exist_ok=True)
    last = recording.nodes[-1][0]
    closure = (full_key(o.robots[0], 0), last, 3, between(recording.nodes[0][2], recording.nodes[-1][2]),
               covariance(recording.rng, 0.02, 0.1, False))
    small = o.ids == "small"
    rename = (lambda key: key & 0xffffffffffffff) if small else (lambda key: key)
    write_g2o(os.path.join(folder, o.graph), recording, rename, [closure])
    keys = sorted(recording.scans)
    names = {}
    for rank, key in enumerate(keys):
        if o.names == "key":
            names[key] = "%d.pcd" % key
        elif o.names == "letter":
            names[key] = "%s%d.pcd" % (chr(key >> 56), key & 0xffffffff)
        elif o.names == "index":
            names[key] = "%d.pcd" % (key & 0xffffffff)
        else:
            names[key] = "pc_%d.pcd" % rank
    stamps = {k: s for k, s, _ in recording.nodes}
    if o.table:
        with open(os.path.join(folder, "keys.csv"), "w", encoding="utf-8") as out:
            for key in keys:
                out.write("%d,pose_graph/%s,%d\n" % (key, names[key], stamps[key]))
    clouds = {names[k]: pcd_bytes(recording.scans[k], o.normals, "ascii" if k % 3 == 0 else "binary") for k in keys}
    if o.place.endswith(".zip"):
        with zipfile.ZipFile(os.path.join(folder, o.place), "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in clouds.items():
                archive.writestr("../../pcd/" + name, data)
    else:
        place = os.path.join(folder, o.place)
        os.makedirs(place, exist_ok=True)
        for name, data in clouds.items():
            with open(os.path.join(place, name), "wb") as out:
                out.write(data)
    if o.truth:
        truth = os.path.join(folder, o.truth)
        os.makedirs(os.path.dirname(truth), exist_ok=True)
        with open(truth, "w", encoding="utf-8") as out:
            for key, pose in recording.truth.items():
                out.write("VERTEX_SE3:QUAT %d %s\n" % (rename(key), g2o_pose(pose)))
    save_expected(folder, recording.expected(closure={"from": str(closure[0]), "to": str(closure[1]),
                                                      "pose": closure[3], "covariance": closure[4]}))


def make_lamp_zip(o):
    recording = Recording(o.robots, o.nodes, o.points, o.seed, normals=True)
    os.makedirs(o.folder, exist_ok=True)
    keys = sorted(recording.scans)
    stamps = {k: s for k, s, _ in recording.nodes}
    bag_path = os.path.join(o.folder, "pose_graph.bag.part")
    nodes = [(k, s, p, "odom_node") for k, s, p in recording.nodes]
    edges = [(a, b, t, p, c, 0.0, 0.0) for a, b, t, p, c in recording.edges]
    edges += [(k, k, 1, p, c, 0.0, 0.0) for k, p, c in recording.priors]
    older = [(k, s, (p[0] + 1.0, *p[1:]), n) for k, s, p, n in nodes]
    with open_bag(bag_path, o.compression) as bag:
        bag.write("pose_graph", graph_message(older, [], START * 10**9), ros_time(START * 10**9))
        bag.write("pose_graph", graph_message(nodes, edges, START * 10**9), ros_time(START * 10**9 + 5))
    prefix = o.prefix
    with zipfile.ZipFile(os.path.join(o.folder, "saved.zip"), "w", zipfile.ZIP_DEFLATED) as archive:
        table = ""
        for rank, key in enumerate(keys):
            archive.writestr("%spc_%d.pcd" % (prefix, rank), pcd_bytes(recording.scans[key], True, "binary"))
            table += "%d,%spc_%d.pcd,%d\n" % (key, prefix, rank, stamps[key])
        archive.writestr(prefix + "keys.csv", table)
        archive.write(bag_path, prefix + "pose_graph.bag")
    os.remove(bag_path)
    recording.truth = {}
    save_expected(o.folder, recording.expected())


def make_sessions(o):
    """Session folders, each in its own frame, and the poses of the frames in the common one."""
    rng = random.Random(o.seed)
    os.makedirs(o.folder, exist_ok=True)
    frames = []
    for s in range(3):
        folder = os.path.join(o.folder, "session%d" % s)
        os.makedirs(os.path.join(folder, "Scans"))
        with open(os.path.join(folder, "optimized_poses.txt"), "w", encoding="utf-8") as poses, \
                open(os.path.join(folder, "times.txt"), "w", encoding="utf-8") as times:
            for i in range(o.nodes):
                poses.write("1 0 0 %r 0 1 0 %r 0 0 1 0\n" % (2.0 * i, 0.5 * s))
                times.write("%d.5\n" % (1000 * s + 2 * i))
                with open(os.path.join(folder, "Scans", "%06d.pcd" % i), "wb") as out:
                    out.write(pcd_bytes(make_points(rng, o.points + s, False), False, "binary"))
        frames.append((10.0 * s, -3.0 * s, 0.5, 0.0, 0.0, math.sin(0.25 * s), math.cos(0.25 * s)))
    with open(os.path.join(o.folder, "frames.csv"), "w", encoding="utf-8") as out:
        out.write("source,x,y,z,qx,qy,qz,qw\n")
        for s in (2, 0, 1):
            out.write("session%d,%s\n" % (s, ",".join(repr(v) for v in frames[s])))
    with open(os.path.join(o.folder, "frames.tum"), "w", encoding="utf-8") as out:
        for s, frame in enumerate(frames):
            out.write("%d %s\n" % (s, g2o_pose(frame)))
    save_expected(o.folder, {"frames": frames})


def make_big(o):
    """A bag of about --megabytes MB of scans, to measure the memory and time of reading it."""
    recording = Recording(o.robots[:1], 4, o.points, o.seed)
    robot = o.robots[0]
    name = ROBOT_NAMES[robot]
    one = cloud_message(recording.scans[full_key(robot, 0)], "pcl", False)
    size = len(one.data)
    count = max(1, o.megabytes * 2**20 // size)
    cls = message_class("pose_graph_msgs/KeyedScan")
    clouds = [cloud_message(recording.scans[full_key(robot, k)], "pcl", False) for k in range(4)]
    with open_bag(os.path.join(o.folder, name + ".bag"), o.compression) as bag:
        previous = None
        for i in range(count):
            key, stamp, pose = full_key(robot, i), (START + INTERVAL * i) * 10**9, pose_on_path(robot, i)
            edges = [(key, key, 1, pose, covariance(recording.rng, 0.01, 0.0016, False), 0.0, 0.0)]
            if previous:
                edges = [(key - 1, key, 0, between(previous, pose), covariance(recording.rng, 0.003, 0.02, True), 0., 0.)]
            bag.write("/" + name + "/lamp/pose_graph_incremental",
                      graph_message([(key, stamp, pose, "odom_node")], edges, stamp), ros_time(stamp))
            bag.write("/" + name + "/lamp/keyed_scans", cls(key=key, scan=clouds[i % 4]), ros_time(stamp + 5))
            previous = pose


def make_probe(_):
    import genpy  # noqa: F401
    import rosbag  # noqa: F401


def main():
    forms = {name[5:]: call for name, call in globals().items() if name.startswith("make_")}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("form", choices=sorted(name for name in forms if name != "points"))
    parser.add_argument("folder")
    parser.add_argument("--compression", default="none", choices=["none", "bz2", "lz4"])
    parser.add_argument("--chunk", type=int, default=768 * 1024, help="bytes after which a chunk ends")
    parser.add_argument("--robots", default="c,e", type=lambda text: text.split(","))
    parser.add_argument("--nodes", type=int, default=6)
    parser.add_argument("--points", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--normals", action="store_true")
    parser.add_argument("--ids", default="full", choices=["full", "small"])
    parser.add_argument("--names", default="key", choices=["key", "letter", "index", "rank"])
    parser.add_argument("--place", default="pcd", help="folder of the clouds, or an archive")
    parser.add_argument("--graph", default="result.g2o")
    parser.add_argument("--truth", default="", help="file for the true poses")
    parser.add_argument("--table", action="store_true", help="write keys.csv")
    parser.add_argument("--prefix", default="pose_graph/")
    parser.add_argument("--megabytes", type=int, default=64)
    options = parser.parse_args()
    if options.form != "probe":
        os.makedirs(options.folder, exist_ok=True)
    forms[options.form](options)


if __name__ == "__main__":
    sys.exit(main())
