#!/usr/bin/python3
"""Writes a database as RTAB-Map 0.21 does, with Python's own sqlite3 and zlib, and expected.json beside it.

    rtabmap_data.py FILE.db [--maps N] [--nodes N] [--points N] [--level L] [--flat] [--no-scans] [--version V]
                    [--no-optimized] [--truth] [--gap] [--odd]

Tables, blobs and enumerations are those of DatabaseSchema.sql.in, DBDriverSqlite3.cpp, Compression.cpp, Link.h and
LaserScan.h: poses are 3x4 floats, information 6x6 doubles, a scan is zlib's data followed by rows, columns and OpenCV's
type. Each link is stored by both of its nodes.
"""
import argparse
import json
import math
import sqlite3
import struct
import zlib

CV_32SC1, CV_32FC1 = 4, 5

SCHEMA = """
CREATE TABLE Node (id INTEGER NOT NULL, map_id INTEGER NOT NULL, weight INTEGER, stamp FLOAT, pose BLOB,
  ground_truth_pose BLOB, velocity BLOB, label TEXT, gps BLOB, env_sensors BLOB, time_enter DATE, PRIMARY KEY (id));
CREATE TABLE Data (id INTEGER NOT NULL, image BLOB, depth BLOB, calibration BLOB, scan BLOB, scan_info BLOB,
  ground_cells BLOB, obstacle_cells BLOB, empty_cells BLOB, cell_size FLOAT, view_point_x FLOAT, view_point_y FLOAT,
  view_point_z FLOAT, user_data BLOB, time_enter DATE, PRIMARY KEY (id));
CREATE TABLE Link (from_id INTEGER NOT NULL, to_id INTEGER NOT NULL, type INTEGER NOT NULL,
  information_matrix BLOB NOT NULL, transform BLOB, user_data BLOB);
CREATE TABLE Word (id INTEGER NOT NULL, descriptor_size INTEGER NOT NULL, descriptor BLOB NOT NULL, time_enter DATE);
CREATE TABLE Feature (node_id INTEGER NOT NULL, word_id INTEGER NOT NULL, pos_x FLOAT NOT NULL, pos_y FLOAT NOT NULL);
CREATE TABLE Info (STM_size INTEGER, last_sign_added INTEGER, parameters TEXT, time_enter DATE);
CREATE TABLE Statistics (id INTEGER NOT NULL, stamp FLOAT, data BLOB, wm_state BLOB);
CREATE TABLE Admin (version TEXT, preview_image BLOB, opt_cloud BLOB, opt_ids BLOB, opt_poses BLOB,
  opt_last_localization BLOB, time_enter DATE);
"""


def yaw_pose(x, y, z, yaw):
    c, s = math.cos(yaw), math.sin(yaw)
    return [[c, -s, 0.0, x], [s, c, 0.0, y], [0.0, 0.0, 1.0, z]]


def multiply(a, b):
    return [[sum(a[i][k] * b[k][j] for k in range(3)) + (a[i][3] if j == 3 else 0.0) for j in range(4)] for i in range(3)]


def inverse(a):
    r = [[a[j][i] for j in range(3)] for i in range(3)]
    return [r[i] + [-sum(r[i][k] * a[k][3] for k in range(3))] for i in range(3)]


def floats(matrix):
    return struct.pack("<12f", *[v for row in matrix for v in row])


def information(*diagonal):
    return struct.pack("<36d", *[diagonal[i] if i == j else 0.0 for i in range(6) for j in range(6)])


def compressed(data, rows, columns, kind, level):
    return zlib.compress(data, level) + struct.pack("<3i", rows, columns, kind)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("file")
    parser.add_argument("--maps", type=int, default=1)
    parser.add_argument("--nodes", type=int, default=6)
    parser.add_argument("--points", type=int, default=50)
    parser.add_argument("--level", type=int, default=-1, help="of zlib; 0 stores, 1 and 9 are unlike the default")
    parser.add_argument("--version", default="0.21.4")
    for flag in ["flat", "no-scans", "no-optimized", "truth", "gap", "odd", "false-closure", "late-start"]:
        parser.add_argument("--" + flag, action="store_true")
    o = parser.parse_args()

    lidar = yaw_pose(0.2, 0.0, 0.5, 0.3)
    database = sqlite3.connect(o.file)
    database.executescript(SCHEMA)
    optimized, expected, node = {}, {"nodes": []}, 0
    for map_id in range(o.maps):
        ids = []
        for i in range(o.nodes):
            node += 1
            odometry = yaw_pose(1.5 * i, 0.1 * i * i, 0.0, 0.15 * i)
            start = yaw_pose(0.0, 20.0 * map_id, 0.0, 0.5 * map_id)
            optimized[node] = multiply(start, yaw_pose(1.5 * i, 0.1 * i * i + 0.05 * i, 0.0, 0.15 * i))
            stamp = 1600000000.25 + 2.0 * node
            truth = floats(multiply(yaw_pose(100.0, 50.0, 3.0, 1.0), optimized[node])) if o.truth else b""
            database.execute("INSERT INTO Node(id, map_id, weight, stamp, pose, ground_truth_pose) VALUES(?,?,?,?,?,?)",
                             (node, map_id, 0, stamp, floats(odometry), truth))
            points = [[1.0 + 0.25 * (k % 200), math.sin(0.3 * k + i), 0.5 * (k % 5), float(k % 7)] for k in range(o.points)]
            if o.odd and points:
                points[0][0] = float("nan")
            flat = b"".join(struct.pack("<4f", *p) for p in points)
            if o.flat:
                scan = compressed(b"".join(struct.pack("<2f", *p[:2]) for p in points), 1, o.points, CV_32FC1 + 8, o.level)
            else:
                scan = compressed(flat, 1, o.points, CV_32FC1 + 3 * 8, o.level)
            info = struct.pack("<7f", 1.0 if o.flat else 6.0, 0.0, 80.0, 0.0, 0.0, 0.0, 0.0) + floats(lidar)
            if not o.no_scans:
                database.execute("INSERT INTO Data(id, scan, scan_info) VALUES(?,?,?)", (node, scan, info))
            ids.append(node)
            expected["nodes"].append({"id": node, "odometry": [v for r in odometry for v in r], "stamp": stamp,
                                      "optimized": [v for r in optimized[node] for v in r]})

        def link(a, b, kind, transform, weights=(100.0, 100.0, 50.0, 400.0, 300.0, 500.0)):
            for f, t, T in ((a, b, transform), (b, a, inverse(transform))):
                database.execute("INSERT INTO Link(from_id, to_id, type, information_matrix, transform) VALUES(?,?,?,?,?)",
                                 (f, t, kind, information(*weights), floats(T)))

        for i in range(o.nodes - 1):
            if (o.gap or o.false_closure) and i == 2:
                if o.false_closure:  # in place of the step of odometry
                    link(ids[i], ids[i + 1], 1, yaw_pose(9.0, -9.0, 0.0, 2.0))
                continue
            step = multiply(inverse(yaw_pose(1.5 * i, 0.1 * i * i, 0.0, 0.15 * i)),
                            yaw_pose(1.5 * (i + 1), 0.1 * (i + 1) ** 2, 0.0, 0.15 * (i + 1)))
            link(ids[i], ids[i + 1], 0, step, (1.0,) * 6 if o.odd and i == 0 else (100.0, 100.0, 50.0, 400.0, 300.0, 500.0))
        link(ids[-1], ids[0], 1, multiply(inverse(optimized[ids[-1]]), optimized[ids[0]]))
        if o.odd:
            for a, b, kind in ((ids[0], ids[0], 9), (ids[1], ids[1], 7), (ids[1], -4, 8), (ids[1], ids[3], 5)):
                database.execute("INSERT INTO Link(from_id, to_id, type, information_matrix, transform) VALUES(?,?,?,?,?)",
                                 (a, b, kind, information(*(1.0,) * 6), floats(yaw_pose(0, 0, 0, 0))))
    if o.odd:  # a discarded node, one without odometry, one without links
        for extra, weight, pose in ((1, -9, floats(yaw_pose(0, 0, 0, 0))), (2, 0, b""), (3, 0, floats(yaw_pose(9, 9, 0, 0)))):
            database.execute("INSERT INTO Node(id, map_id, weight, stamp, pose) VALUES(?,?,?,?,?)",
                             (node + extra, o.maps - 1, weight, 1700000000.0, pose))
    if o.late_start:  # the last map lost its first node
        del optimized[node - o.nodes + 1]
    ids = b"".join(struct.pack("<i", i) for i in optimized)
    poses = b"".join(floats(p) for p in optimized.values())
    database.execute("INSERT INTO Admin(version, opt_ids, opt_poses) VALUES(?,?,?)",
                     (o.version, None if o.no_optimized else compressed(ids, 1, len(optimized), CV_32SC1, o.level),
                      None if o.no_optimized else compressed(poses, 1, 12 * len(optimized), CV_32FC1, o.level)))
    database.commit()
    database.close()
    expected["lidar"] = [v for r in lidar for v in r]
    with open(o.file + ".json", "w", encoding="utf-8") as out:
        json.dump(expected, out)


main()
