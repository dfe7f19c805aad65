#!/usr/bin/python3
"""Writes the data of lamp_data.py as bags of ROS 2, with Python's own sqlite3 and an independent writer of MCAP and CDR.
Also writes recordings of odometry and clouds.

    rosbag2_data.py FORM FOLDER [--storage mcap|db3|rosbag1] [--pack ...] [--split N] [--metadata] [...]

FORM is one of lamp_data.py's, whose arguments follow, or stream: odometry and clouds of each robot, without graphs.
"""
import argparse
import ctypes
import ctypes.util
import os
import re
import sqlite3
import struct
import sys
import zlib

import lamp_data

OPTIONS = None
SIZES = {"bool": "B", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i",
         "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d"}

lamp_data.TYPES["sensor_msgs/PointCloud2"] = (lamp_data.CLOUD, {
    "std_msgs/Header": lamp_data.HEADER, "sensor_msgs/PointField": lamp_data.FIELD})
lamp_data.TYPES["geometry_msgs/PoseStamped"] = ("Header header\nPose pose\n", lamp_data.BASE)
lamp_data.TYPES["tf2_msgs/TFMessage"] = ("geometry_msgs/TransformStamped[] transforms\n", {
    "std_msgs/Header": lamp_data.HEADER,
    "geometry_msgs/TransformStamped": "Header header\nstring child_frame_id\nTransform transform\n",
    "geometry_msgs/Transform": "Vector3 translation\nQuaternion rotation\n",
    "geometry_msgs/Vector3": lamp_data.POINT, "geometry_msgs/Quaternion": lamp_data.QUATERNION})
lamp_data.TYPES["std_msgs/String"] = ("string data\n", {})


# ---- Compression, by the libraries themselves ----

def library(name):
    return ctypes.CDLL(ctypes.util.find_library(name) or "lib%s.so.1" % name)


def zstd(data):
    lib = library("zstd")
    lib.ZSTD_compressBound.restype = lib.ZSTD_compress.restype = ctypes.c_size_t
    lib.ZSTD_compressBound.argtypes = [ctypes.c_size_t]
    lib.ZSTD_compress.argtypes = [ctypes.c_char_p, ctypes.c_size_t, ctypes.c_char_p, ctypes.c_size_t, ctypes.c_int]
    out = ctypes.create_string_buffer(lib.ZSTD_compressBound(len(data)))
    size = lib.ZSTD_compress(out, len(out), data, len(data), 1)
    return out.raw[:size]


def lz4(data):
    lib = library("lz4")
    lib.LZ4F_compressFrameBound.restype = lib.LZ4F_compressFrame.restype = ctypes.c_size_t
    lib.LZ4F_compressFrameBound.argtypes = [ctypes.c_size_t, ctypes.c_void_p]
    lib.LZ4F_compressFrame.argtypes = [ctypes.c_char_p, ctypes.c_size_t, ctypes.c_char_p, ctypes.c_size_t,
                                       ctypes.c_void_p]
    out = ctypes.create_string_buffer(lib.LZ4F_compressFrameBound(len(data), None))
    size = lib.LZ4F_compressFrame(out, len(out), data, len(data), None)
    return out.raw[:size]


# ---- CDR ----

class Cdr:
    """Plain CDR of a message, with alignment relative to the end of the four bytes of the header."""

    def __init__(self, big_endian):
        self.order = ">" if big_endian else "<"
        self.out = bytearray()

    def number(self, letter, value):
        size = struct.calcsize("=" + letter)
        self.out += b"\0" * (-len(self.out) % size)
        self.out += struct.pack(self.order + letter, value)

    def value(self, kind, value):
        array = re.fullmatch(r"(.*)\[(\d*)\]", kind)
        if array:
            if not array.group(2):
                self.number("I", len(value))
            if array.group(1) == "uint8":
                self.out += bytes(value)
            else:
                for element in value:
                    self.value(array.group(1), element)
        elif kind in SIZES:
            self.number(SIZES[kind], value)
        elif kind == "string":
            text = value.encode() if isinstance(value, str) else bytes(value)
            self.number("I", len(text) + 1)
            self.out += text + b"\0"
        elif kind in ("time", "duration"):
            self.number("i", value.secs)
            self.number("I", value.nsecs)
        else:
            self.message(value)

    def message(self, message):
        for name, kind in zip(message.__slots__, message._slot_types):
            if name != "seq":  # ROS 2's header has none
                self.value(kind, getattr(message, name))


def cdr(message, big_endian=False):
    body = Cdr(big_endian)
    body.message(message)
    body.out += b"\0" * (-len(body.out) % 4)
    return (b"\0\0\0\0" if big_endian else b"\0\1\0\0") + bytes(body.out)


def ros2_type(name):
    return name.replace("/", "/msg/")


def ros2_definition(name):
    """The definition as rosbag2 records it, with the additions of ROS 2: bounds, defaults, times as messages."""
    own, used = lamp_data.TYPES[name]
    text = own
    for other, definition in used.items():
        text += "=" * 80 + "\nMSG: " + other + "\n" + definition
    text = re.sub(r"^Header ", "std_msgs/Header ", text, flags=re.M).replace("uint32 seq\n", "")
    text = text.replace("time stamp", "builtin_interfaces/Time stamp")
    text = text.replace("PointField[] fields", "PointField[<=64] fields").replace("string frame_id",
                                                                                  "string<=512 frame_id \"map # = x\"")
    text += "=" * 80 + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    return text.replace("bool is_dense", "bool is_dense true")


# ---- Storages: messages are (topic, type, stamp, bytes) ----

def write_db3(path, messages):
    data = sqlite3.connect(path)
    data.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, "
                 "serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL)")
    data.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, "
                 "data BLOB NOT NULL)")
    data.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")
    if OPTIONS.definitions:
        data.execute("CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT "
                     "NOT NULL, encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL)")
        for kind in sorted({m[1] for m in messages}):
            data.execute("INSERT INTO message_definitions (topic_type, encoding, encoded_message_definition, "
                         "type_description_hash) VALUES (?, 'ros2msg', ?, '')", (ros2_type(kind), ros2_definition(kind)))
    topics = {}
    for topic, kind, stamp, raw in messages:
        if topic not in topics:
            topics[topic] = len(topics) + 1
            data.execute("INSERT INTO topics VALUES (?, ?, ?, ?, '')",
                         (topics[topic], topic, ros2_type(kind), OPTIONS.encoding))
        raw = zstd(raw) if OPTIONS.pack == "message" else raw
        data.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", (topics[topic], stamp, raw))
    data.commit()
    data.close()


def text_field(text):
    return struct.pack("<I", len(text)) + text


def record(op, content):
    return struct.pack("<BQ", op, len(content)) + content


class McapFile:
    """An MCAP file by its specification, with an index and a summary as recorders write them."""

    def __init__(self, chunked=True, compression="", chunk_size=4000):
        self.chunked, self.compression, self.chunk_size = chunked, compression, chunk_size
        self.out = bytearray(b"\x89MCAP0\r\n" + record(1, text_field(b"ros2") + text_field(b"rosbag2_data.py")))
        self.described, self.summary, self.chunk, self.indexes = {}, b"", bytearray(), {}
        self.times, self.count, self.chunk_indexes, self.written = [], 0, b"", 0

    def position(self):
        return self.written + len(self.out)

    def flush(self, file):
        """Writes the pending bytes to a file, so that large bags do not stay in memory."""
        file.write(self.out)
        self.written += len(self.out)
        self.out = bytearray()

    def describe(self, topic, kind):
        number = self.described.setdefault(topic, len(self.described) + 1)
        definition = ros2_definition(kind).encode() if OPTIONS.definitions else b""
        schema = record(3, struct.pack("<H", number) + text_field(ros2_type(kind).encode()) + text_field(b"ros2msg") +
                        text_field(definition))
        channel = record(4, struct.pack("<HH", number, number) + text_field(topic.encode()) +
                         text_field(OPTIONS.encoding.encode()) + text_field(text_field(b"qos") + text_field(b"")))
        self.summary += schema + channel
        return schema + channel

    def write(self, topic, kind, stamp, raw):
        target = self.chunk if self.chunked else self.out
        if topic not in self.described:
            target += self.describe(topic, kind)
        self.count += 1
        number = self.described[topic]
        self.indexes.setdefault(number, []).append((stamp, len(target)))
        self.times.append(stamp)
        target += record(5, struct.pack("<HIQQ", number, self.count, stamp, stamp) + raw)
        if len(self.chunk) > self.chunk_size:
            self.end_chunk()

    def end_chunk(self):
        if not self.chunk:
            return
        raw = bytes(self.chunk)
        data = zstd(raw) if self.compression == "zstd" else lz4(raw) if self.compression == "lz4" else raw
        at = self.position()
        head = struct.pack("<QQQI", min(self.times), max(self.times), len(raw), zlib.crc32(raw))
        self.out += record(6, head + text_field(self.compression.encode()) + struct.pack("<Q", len(data)) + data)
        length, where, before = self.position() - at, b"", self.position()
        for number, entries in self.indexes.items():
            where += struct.pack("<HQ", number, self.position())
            listed = b"".join(struct.pack("<QQ", *entry) for entry in entries)
            self.out += record(7, struct.pack("<HI", number, len(listed)) + listed)
        self.chunk_indexes += record(8, struct.pack("<QQQQI", min(self.times), max(self.times), at, length, len(where)) +
                                     where + struct.pack("<Q", self.position() - before) +
                                     text_field(self.compression.encode()) + struct.pack("<QQ", len(data), len(raw)))
        self.chunk, self.indexes, self.times = bytearray(), {}, []

    def finish(self):
        self.end_chunk()
        self.out += record(15, struct.pack("<I", 0))
        start = self.position() if OPTIONS.summary else 0
        if OPTIONS.summary:
            self.out += self.summary + self.chunk_indexes
            self.out += record(11, struct.pack("<QHIIIIQQI", self.count, len(self.described), len(self.described), 0, 0, 0,
                                               0, 0, 0))
        self.out += record(2, struct.pack("<QQI", start, 0, 0)) + b"\x89MCAP0\r\n"
        return bytes(self.out)


def write_mcap(path, messages):
    packed = OPTIONS.pack if OPTIONS.pack in ("zstd", "lz4") else ""
    mcap = McapFile(not OPTIONS.unchunked, packed)
    for topic, kind, stamp, raw in messages:
        mcap.write(topic, kind, stamp, zstd(raw) if OPTIONS.pack == "message" else raw)
    with open(path, "wb") as out:
        out.write(mcap.finish())


class Rosbag2:
    """Has the interface of rosbag.Bag, and writes its messages when it is closed."""

    def __init__(self, path):
        self.base = path[:-len(".bag")]
        self.messages = []

    def __enter__(self):
        return self

    def write(self, topic, message, stamp):
        self.messages.append((topic, message._type, stamp.to_nsec(), cdr(message, OPTIONS.big_endian)))

    def __exit__(self, *_):
        write = write_mcap if OPTIONS.storage == "mcap" else write_db3
        base = self.base
        if OPTIONS.split or OPTIONS.metadata:
            os.makedirs(base, exist_ok=True)
            base = os.path.join(base, os.path.basename(base))
        else:
            os.makedirs(os.path.dirname(base) or ".", exist_ok=True)
        size = OPTIONS.split or len(self.messages) or 1
        names = []
        for i in range(0, max(1, len(self.messages)), size):
            path = base + ("_%d" % (i // size) if OPTIONS.split or OPTIONS.metadata else "") + "." + OPTIONS.storage
            write(path, self.messages[i:i + size])
            if OPTIONS.pack == "file":
                with open(path, "rb") as plain, open(path + ".zstd", "wb") as out:
                    out.write(zstd(plain.read()))
                os.remove(path)
                path += ".zstd"
            names.append(os.path.basename(path))
        if OPTIONS.metadata:
            self.write_metadata(os.path.dirname(base), names)

    def write_metadata(self, folder, names):
        mode = {"file": "FILE", "message": "MESSAGE"}.get(OPTIONS.pack, "")
        with open(os.path.join(folder, "metadata.yaml"), "w", encoding="utf-8") as out:
            out.write("rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: %s\n  duration:\n"
                      "    nanoseconds: 1\n  message_count: %d\n  topics_with_message_count:\n"
                      "    - topic_metadata:\n        name: /x\n        offered_qos_profiles: \"- history: 3\\n\"\n"
                      % ("mcap" if OPTIONS.storage == "mcap" else "sqlite3", len(self.messages)))
            out.write("  compression_format: \"%s\"\n  compression_mode: \"%s\"\n  relative_file_paths:\n" %
                      ("zstd" if mode else "", mode))
            out.writelines("    - %s\n" % name for name in names)
            out.write("  files:\n    - path: %s\n" % names[0])


# ---- Odometry and clouds ----

def cloud_of(points, stamp, frame, layout):
    """A separate sensor_msgs/PointCloud2; lamp_data.py makes those inside keyed scans."""
    made = lamp_data.cloud_message(points, layout, False)
    cloud = lamp_data.message_class("sensor_msgs/PointCloud2")()
    for name in cloud.__slots__:
        if name != "header":
            setattr(cloud, name, getattr(made, name))
    cloud.header.stamp = lamp_data.ros_time(stamp)
    cloud.header.frame_id = frame
    return cloud


def static_transform(parent, child, pose):
    cls = lamp_data.message_class("tf2_msgs/TFMessage")
    transform = lamp_data.message_class("tf2_msgs/TFMessage", "geometry_msgs/TransformStamped")()
    transform.header.frame_id, transform.child_frame_id = parent, child
    t, r = transform.transform.translation, transform.transform.rotation
    t.x, t.y, t.z = pose[:3]
    r.x, r.y, r.z, r.w = pose[3:]
    return cls(transforms=[transform])


def pose_message(stamp, pose):
    message = lamp_data.message_class("geometry_msgs/PoseStamped")()
    message.header.stamp = lamp_data.ros_time(stamp)
    message.header.frame_id = "odom"
    lamp_data.set_pose(message.pose, pose)
    return message


SENSOR = (0.3, -0.1, 0.8, 0.0, 0.0, 0.7071067811865476, 0.7071067811865476)
SWEEPS_PER_NODE = 20


def interpolated(robot, step):
    """Poses along the path at 10 Hz, on straight lines between nodes, so that the expected poses are exact."""
    i, part = divmod(step, SWEEPS_PER_NODE)
    a, b = lamp_data.pose_on_path(robot, i), lamp_data.pose_on_path(robot, i + 1)
    share = part / SWEEPS_PER_NODE
    return (*(a[k] + share * (b[k] - a[k]) for k in range(3)), *a[3:])


def compose(a, b):
    """T_x_b for a = T_x_a and b = T_a_b."""
    turned = lamp_data.rotate(a[3:], b[:3])
    return (*(a[k] + turned[k] for k in range(3)), *lamp_data.multiply(a[3:], b[3:]))


def move(pose, points):
    return [(compose(pose, (*p, 0.0, 0.0, 0.0, 1.0))[:3], i, n) for p, i, n in points]


def make_stream(o):
    rng = lamp_data.random.Random(o.seed)
    expected = {"robots": []}
    os.makedirs(o.folder, exist_ok=True)
    with lamp_data.open_bag(os.path.join(o.folder, "run.bag")) as bag:
        messages = []
        for n, robot in enumerate(o.robots):
            space = "/" + lamp_data.ROBOT_NAMES[robot] if len(o.robots) > 1 else ""
            stamps, poses, clouds = [], [], []
            for step in range(o.nodes * SWEEPS_PER_NODE):
                stamp = lamp_data.START * 10**9 + step * 100_000_000 + n * 1000 + 1
                pose = interpolated(robot, step)
                if OPTIONS.poses:
                    messages.append((stamp + 100, space + "/pose", pose_message(stamp, pose)))
                else:
                    odometry = lamp_data.odometry_message(stamp, pose)
                    odometry.header.frame_id = space.strip("/") + "odom"
                    messages.append((stamp + 100, space + "/lio/odometry", odometry))
                points = lamp_data.make_points(rng, o.points, False)
                frame = {"body": "base_link", "sensor": "lidar", "other": "lidar",
                         "world": space.strip("/") + "odom"}[OPTIONS.frame]
                layout = ("pcl", "odd", "big", "rows")[step % 4]
                shown = move(pose, points) if OPTIONS.frame == "world" else points
                messages.append((stamp + 200, space + "/points", cloud_of(shown, stamp, frame, layout)))
                true = compose((5.0, 6.0, 7.0, 0.0, 0.0, 1.0, 0.0), pose)
                truth = lamp_data.odometry_message(stamp, true)
                truth.header.frame_id = "mocap"
                if OPTIONS.truth_topic:
                    messages.append((stamp + 300, space + OPTIONS.truth_topic, truth))
                if OPTIONS.frame == "sensor":
                    pose = compose(pose, SENSOR)
                stamps.append(str(stamp))
                poses.append(pose)
                clouds.append([p for p, _, _ in points])
            expected["robots"].append({"name": space.strip("/"), "stamps": stamps, "poses": poses, "clouds": clouds})
        if OPTIONS.frame == "sensor":
            messages.append((1, "/tf_static", static_transform("base_link", "lidar", SENSOR)))
        note = lamp_data.message_class("std_msgs/String")(data="of no use")
        messages += [(lamp_data.START * 10**9, "/note", note)]
        messages.sort(key=lambda entry: entry[0])
        for stamp, topic, message in messages:
            bag.write(topic, message, lamp_data.ros_time(stamp))
    lamp_data.save_expected(o.folder, expected)


def make_bigstream(o):
    """Odometry and clouds of about --megabytes MB, to measure the memory and time of reading them."""
    rng = lamp_data.random.Random(o.seed)
    points = [lamp_data.make_points(rng, o.points, False) for _ in range(4)]
    clouds = [cloud_of(p, 0, "base_link", "pcl") for p in points]
    count = max(1, o.megabytes * 2**20 // len(clouds[0].data))
    path = os.path.join(o.folder, "big." + OPTIONS.storage)
    mcap = McapFile(True, OPTIONS.pack if OPTIONS.pack in ("zstd", "lz4") else "", 4 * 2**20)
    data = None
    if OPTIONS.storage == "db3":
        write_db3(path, [])
        data = sqlite3.connect(path)
        for number, (name, kind) in enumerate((("/odometry", "nav_msgs/Odometry"), ("/points", "sensor_msgs/PointCloud2"))):
            data.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '')", (number + 1, name, ros2_type(kind)))
    with open(path + ".part", "wb") as out:
        for i in range(count):
            stamp = lamp_data.START * 10**9 + i * 100_000_000
            odometry = lamp_data.odometry_message(stamp, (0.5 * i, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
            cloud = clouds[i % 4]
            cloud.header.stamp = lamp_data.ros_time(stamp)
            for number, (name, message) in enumerate((("/odometry", odometry), ("/points", cloud))):
                if data:
                    data.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)",
                                 (number + 1, stamp, cdr(message)))
                else:
                    mcap.write(name, message._type, stamp, cdr(message))
            if not data:
                mcap.flush(out)
        if not data:
            out.write(mcap.finish())
    if data:
        data.commit()
        data.close()
        os.remove(path + ".part")
    else:
        os.rename(path + ".part", path)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter,
                                     add_help=False)
    parser.add_argument("--storage", default="mcap", choices=["mcap", "db3", "rosbag1"])
    parser.add_argument("--pack", default="none", choices=["none", "zstd", "lz4", "file", "message"],
                        help="chunks of MCAP by zstd or lz4, or what rosbag2 does: files or messages by zstd")
    parser.add_argument("--split", type=int, default=0, help="messages of a file")
    parser.add_argument("--metadata", action="store_true")
    parser.add_argument("--definitions", action="store_true")
    parser.add_argument("--big-endian", action="store_true")
    parser.add_argument("--unchunked", action="store_true")
    parser.add_argument("--no-summary", dest="summary", action="store_false")
    parser.add_argument("--encoding", default="cdr")
    parser.add_argument("--frame", default="body", choices=["body", "sensor", "world", "other"])
    parser.add_argument("--poses", action="store_true", help="PoseStamped in the place of odometry")
    parser.add_argument("--truth-topic", default="")
    global OPTIONS
    OPTIONS, rest = parser.parse_known_args()
    if OPTIONS.storage != "rosbag1":
        lamp_data.open_bag = lambda path, *_: Rosbag2(path)
    lamp_data.make_stream, lamp_data.make_bigstream = make_stream, make_bigstream
    sys.argv[1:] = rest
    lamp_data.main()


if __name__ == "__main__":
    sys.exit(main())
