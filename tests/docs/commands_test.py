#!/usr/bin/env python3
# SPDX-License-Identifier: BSD-3-Clause
"""Tests the commands of the documentation. Every option that a page uses exists. The commands of the pages that users
follow from top to bottom run, on generated data.

    commands_test.py LOOPWISE SOURCE_TREE [--options-only] [--times]
"""
import pathlib
import re
import shlex
import shutil
import sqlite3
import struct
import subprocess
import sys
import tempfile
import time

PROGRAM, TREE = pathlib.Path(sys.argv[1]).resolve(), pathlib.Path(sys.argv[2]).resolve()
RUN = ["docs/guide.md", "README.md", "docs/merging.md", "docs/report.md", "docs/places.md"]
# Commands that this test cannot run, with the reason. Their options are checked.
NOT_RUN = {
    "tunnel": "needs the NeBula data set",
    "tunnel/rosbag": "needs the NeBula data set",
    "simulate": "missions of full size take minutes",
    "--clock": "takes as long as the mission",
}


def commands(page):
    """(line, command) of the indented lines of a page that call the program; a synopsis has further lines."""
    lines = (TREE / page).read_text(encoding="utf-8").splitlines()
    for number, line in enumerate(lines, 1):
        match = re.match(r"    (loopwise (?:[^#]*))", line)
        if match:
            # Some pages explain a command after it, beyond several blanks.
            text = re.split(r"\s{3,}", match[1].strip())[0]
            for further in lines[number:]:
                if not re.match(r" {12,}\[", further):
                    break
                text += " " + further.strip()
            yield number, text


def options_of(command, known={}):
    if command not in known:
        text = subprocess.run([PROGRAM, *command, "--help"], capture_output=True, text=True, check=False)
        # The lines that define options begin with them; descriptions may name those of other commands.
        defined = "\n".join(line[:60] for line in text.stdout.splitlines() if re.match(r"\s+-", line))
        known[command] = set(re.findall(r"(?<![\w-])--?[a-zA-Z][\w-]*", defined)) if text.returncode == 0 else None
    return known[command]


def check_options():
    """Returns messages about commands and options that do not exist."""
    faults, checked = [], 0
    for page in sorted(TREE.glob("docs/*.md")) + [TREE / "README.md"]:
        for number, text in commands(page.relative_to(TREE)):
            words = re.sub(r"[\[\]|]", " ", text).split()[1:]
            command = (words[0],) if words[0] != "study" or len(words) < 2 else (words[0], words[1])
            known = options_of(command)
            where = f"{page.relative_to(TREE)}:{number}: "
            if known is None:
                faults.append(where + "no such command: " + " ".join(command))
                continue
            checked += 1
            given = [w.split("=")[0].rstrip(".") for w in words if re.match(r"--?[a-zA-Z]", w)]
            faults += [where + f"{' '.join(command)} has no option {o}" for o in given if o not in known]
    return faults, checked


class Poses:
    """A robot of the sample mission: rows of id, translation, quaternion and stamp, and the points of its scans."""

    def __init__(self, folder, first, last):
        self.rows = []
        stamps = dict(line.split(",") for line in (folder / "stamps.csv").read_text().split()[1:])
        for line in (folder / "graph.g2o").read_text().splitlines():
            words = line.split()
            if words[0] == "VERTEX_SE3:QUAT" and first <= int(words[1]) <= last:
                self.rows.append((words[1], [float(w) for w in words[2:9]], int(stamps[words[1]])))

    def matrices(self):
        for _, (x, y, z, a, b, c, w), _ in self.rows:
            yield [[1 - 2 * (b * b + c * c), 2 * (a * b - c * w), 2 * (a * c + b * w), x],
                   [2 * (a * b + c * w), 1 - 2 * (a * a + c * c), 2 * (b * c - a * w), y],
                   [2 * (a * c - b * w), 2 * (b * c + a * w), 1 - 2 * (a * a + b * b), z]]

    def kitti(self):
        return "".join(" ".join(f"{v:.12g}" for row in m for v in row) + "\n" for m in self.matrices())


def points_of(ply):
    """Points of a PLY file that the program wrote."""
    data = ply.read_bytes()
    head, body = data.split(b"end_header\n", 1)
    count = int(re.search(rb"element vertex (\d+)", head)[1])
    names = re.findall(rb"property (\w+) (\w+)", head)
    size = sum(8 if t == b"double" else 4 if t in (b"float", b"int", b"uint") else 1 for t, _ in names)
    return [struct.unpack_from("<3f", body, i * size) for i in range(count)]


def string(text):
    data = text.encode() + b"\0"
    return struct.pack("<I", len(data)) + data


def aligned(data, size):
    return data + b"\0" * (-len(data) % size)


def header(stamp_ns, frame):
    return aligned(struct.pack("<iI", stamp_ns // 10**9, stamp_ns % 10**9) + string(frame), 4)


def odometry_message(stamp_ns, pose):
    body = aligned(header(stamp_ns, "odom") + string("base"), 8)
    covariance = [1e-4 if i % 7 == 0 else 0.0 for i in range(36)]
    return b"\0\1\0\0" + body + struct.pack("<7d36d6d36d", *pose, *covariance, *[0.0] * 6, *[0.0] * 36)


def cloud_message(stamp_ns, points):
    body = header(stamp_ns, "base") + struct.pack("<II", 1, len(points))
    body += struct.pack("<I", 3)
    for i, name in enumerate("xyz"):
        body = aligned(body + string(name), 4) + struct.pack("<IB", 4 * i, 7)
        body = aligned(body, 4) + struct.pack("<I", 1)
    body += struct.pack("<B", 0)
    data = b"".join(struct.pack("<3f", *p) for p in points)
    body = aligned(body, 4) + struct.pack("<II", 12, 12 * len(points))
    return b"\0\1\0\0" + body + struct.pack("<I", len(data)) + data + b"\1"


def messages(robot, points):
    """(topic number, stamp, CDR) of a bag."""
    for (_, pose, stamp), cloud in zip(robot.rows, points):
        yield 1, stamp, odometry_message(stamp, pose)
        yield 2, stamp, cloud_message(stamp, cloud)


TOPICS = {1: ("/lio/odometry", "nav_msgs/msg/Odometry"), 2: ("/points", "sensor_msgs/msg/PointCloud2")}


def write_db3(folder, bag):
    """As rosbag2 writes it, without metadata.yaml."""
    folder.mkdir()
    with sqlite3.connect(folder / "my_bag_0.db3") as base:
        base.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT, "
                     "offered_qos_profiles TEXT)")
        base.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
        base.executemany("INSERT INTO topics VALUES(?, ?, ?, 'cdr', '')", [(i, *t) for i, t in TOPICS.items()])
        base.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)", bag)
    base.close()


def write_mcap(path, bag):
    """Without chunks and summary, by the specification of MCAP."""
    def record(code, body):
        return struct.pack("<BQ", code, len(body)) + body

    def text(value):
        return struct.pack("<I", len(value)) + value.encode()

    magic = b"\x89MCAP0\r\n"
    out = magic + record(1, text("ros2") + text("commands_test"))
    for i, (name, kind) in TOPICS.items():
        out += record(3, struct.pack("<H", i) + text(kind) + text("ros2msg") + struct.pack("<I", 0))
        out += record(4, struct.pack("<HH", i, i) + text(name) + text("cdr") + struct.pack("<I", 0))
    for count, (topic, stamp, data) in enumerate(bag):
        out += record(5, struct.pack("<HIQQ", topic, count, stamp, stamp) + data)
    out += record(15, struct.pack("<I", 0)) + record(2, struct.pack("<QQI", 0, 0, 0)) + magic
    path.write_bytes(out)


def write_part(mission, target, first, last):
    """The mission of one of its robots."""
    (target / "scans").mkdir(parents=True)
    for name in ("graph.g2o", "ground_truth.g2o"):
        kept = [line for line in (mission / name).read_text().splitlines()
                if all(first <= int(w) <= last for w in line.split()[1:3 if line.startswith("EDGE") else 2])]
        (target / name).write_text("\n".join(kept) + "\n")
    for name in ("stamps.csv",):
        rows = (mission / name).read_text().splitlines()
        (target / name).write_text("\n".join(rows[:1] + [r for r in rows[1:] if first <= int(r.split(",")[0]) <= last]) + "\n")
    for scan in (mission / "scans").iterdir():
        if first <= int(scan.stem) <= last:
            shutil.copy(scan, target / "scans")
    (target / "mission.json").write_text('{"format": "loopwise-mission", "version": 1}')


def loopwise(folder, *arguments):
    subprocess.run([PROGRAM, *arguments, "--quiet"], cwd=folder, check=True, stdout=subprocess.DEVNULL)


def make_data(folder):
    """Generates all files that the commands name."""
    sample = TREE / "data/sample_mission"
    (folder / "data").mkdir()
    (folder / "data/sample_mission").symlink_to(sample)
    mission = folder / "my_mission"
    shutil.copytree(sample, mission)
    for path in [*mission.glob("*.csv"), mission / "mission.json"]:
        path.write_text(path.read_text().replace("wheeled1", "husky"))
    ids = sorted(int(scan.stem) for scan in (sample / "scans").iterdir())
    second = 7061644215716937728  # the first key of the second robot
    first_robot, robots = Poses(sample, 0, second - 1), ((0, second - 1), (second, 2**63))
    for names, (low, high) in zip((("s1", "session1", "session4"), ("s2", "session2")), robots):
        for name in names:
            write_part(sample, folder / name, low, high)
    write_part(sample, folder / "session3", ids[-12], ids[-1])  # few candidates keep the test short
    (folder / "missions").mkdir()
    shutil.copytree(mission, folder / "missions/one")
    shutil.copy(sample / "graph.g2o", folder)
    shutil.copytree(sample / "scans", folder / "clouds")
    shutil.copy(sample / f"scans/{ids[5]}.pcd", folder / "a.pcd")
    shutil.copy(sample / f"scans/{ids[6]}.pcd", folder / "b.pcd")
    (folder / "frames.csv").write_text("source,x,y,z,yaw,sx,sy,sz,syaw\nsession1,0,0,0,0,0.01,0.01,0.01,0.001\n"
                                       "session2,0,0,0,0,0.5,0.5,0.2,0.05\n")
    (folder / "pairs.csv").write_text(f"from,to,score\n{ids[0]},{ids[20]},0.8\n")
    loopwise(folder, "convert", "my_mission", "-o", "tum", "--to", "tum")
    shutil.copy(folder / "tum/husky_truth.tum", folder / "truth.tum")
    clouds = []
    (folder / "ply").mkdir()
    for key, _, _ in first_robot.rows:
        # A registration of a scan with itself writes the cloud in another encoding.
        loopwise(folder, "register", f"clouds/{key}.pcd", f"clouds/{key}.pcd", "--out", f"ply/{key}.ply")
        clouds.append(points_of(folder / f"ply/{key}.ply"))
    sequence, session = folder / "dataset/sequences/00", folder / "my_session"
    (sequence / "velodyne").mkdir(parents=True)
    (session / "Scans").mkdir(parents=True)
    for i, (key, cloud) in enumerate(zip((r[0] for r in first_robot.rows), clouds)):
        (sequence / f"velodyne/{i:06}.bin").write_bytes(b"".join(struct.pack("<4f", *p, 0.0) for p in cloud))
        shutil.copy(sample / f"scans/{key}.pcd", session / f"Scans/{i:06}.pcd")
    start = first_robot.rows[0][2]
    times = "".join(f"{(r[2] - start) * 1e-9:.6f}\n" for r in first_robot.rows)
    for path, text in ((sequence / "times.txt", times), (session / "times.txt", times),
                       (sequence / "poses.txt", first_robot.kitti()), (folder / "odometry.txt", first_robot.kitti()),
                       (session / "odom_poses.txt", first_robot.kitti()),
                       (session / "optimized_poses.txt", first_robot.kitti())):
        path.write_text(text)
    write_db3(folder / "my_bag", messages(first_robot, clouds))
    write_mcap(folder / "my_bag.mcap", messages(first_robot, clouds))


def decide(folder):
    """A decision on the first closure of the last run."""
    rows = (folder / "out/closures.csv").read_text().splitlines()
    names = rows[0].split(",")
    row = dict(zip(names, next(r for r in rows[1:] if "verified" in r.split(",")).split(",")))
    (folder / "decisions.csv").write_text(f"from,to,decision\n{row['from']},{row['to']},reject\n")


def run_page(page, folder):
    faults, ran, left_out = [], 0, []
    for number, text in commands(page):
        text = re.sub(r"\bMISSION\b", "my_mission", text)
        words = shlex.split(text)
        reason = next((why for word, why in NOT_RUN.items() if word in words), None)
        if reason:
            left_out.append(f"{page}:{number}: {text}: {reason}")
            continue
        output = words[words.index("-o") + 1] if "-o" in words else None
        if output and (folder / output).is_dir():
            shutil.rmtree(folder / output)
        if "decisions.csv" in words and not (folder / "decisions.csv").exists():
            decide(folder)
        begin = time.monotonic()
        result = subprocess.run(["bash", "-c", 'PATH="$1:$PATH"; eval "$2"', "bash", str(folder / "bin"), text],
                                cwd=folder, capture_output=True, text=True, check=False)
        ran += 1
        if "--times" in sys.argv:
            print(f"  {time.monotonic() - begin:6.1f} s {text}")
        if "this build cannot write reports" in result.stderr:
            left_out.append(f"{page}:{number}: {text}: this build has no page of reports")
        elif result.returncode != 0:
            faults.append(f"{page}:{number}: {text}: status {result.returncode}\n{result.stderr[-600:]}")
    if ran + len(left_out) == 0:
        faults.append(f"{page}: no command found")
    return faults, ran, left_out


def main():
    faults, checked = check_options()
    print(f"{checked} commands of the documentation: options checked")
    if checked < 70:
        faults.append(f"only {checked} commands found: has the form of the pages changed?")
    if "--options-only" not in sys.argv:
        with tempfile.TemporaryDirectory() as name:
            folder = pathlib.Path(name)
            (folder / "bin").mkdir()
            (folder / "bin/loopwise").symlink_to(PROGRAM)
            make_data(folder)
            for page in RUN:
                found, ran, left_out = run_page(page, folder)
                faults += found
                print(f"{page}: {ran} commands ran, {len(left_out)} left out")
                for text in left_out:
                    print("  left out: " + text)
    for fault in faults:
        print("FAULT " + fault)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
