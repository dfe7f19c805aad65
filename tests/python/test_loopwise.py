# SPDX-License-Identifier: BSD-3-Clause
"""Tests the Python package: compares each part with NumPy or with the library's own results."""

import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import unittest

import numpy as np

import loopwise as lw

SOURCE = pathlib.Path(os.environ.get("LOOPWISE_SOURCE_DIR", pathlib.Path(__file__).resolve().parents[2]))
SAMPLE = SOURCE / "data" / "sample_mission"


def pose(x=0.0, y=0.0, z=0.0, yaw=0.0):
    T = np.eye(4)
    T[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    T[:3, 3] = [x, y, z]
    return T


def square(steps=8, drift=0.02):
    """A square path that returns to its start, with odometry that overestimates the turns."""
    graph = lw.PoseGraph()
    step = pose(2.0, yaw=2.0 * np.pi / steps + drift)
    T = np.eye(4)
    for i in range(steps + 1):
        graph.add_node(lw.make_key("a", i), T, stamp_ns=2_000_000_000 * i)
        if i:
            graph.add_edge(lw.make_key("a", i - 1), lw.make_key("a", i), step, sigmas=[0.1] * 3 + [0.02] * 3,
                           kind=lw.EdgeKind.ODOMETRY)
        T = T @ step
    graph.add_prior("a0", np.eye(4), sigmas=[1e-3] * 6)
    return graph


class Keys(unittest.TestCase):
    def test_names(self):
        self.assertEqual(lw.key("a12"), 6989586621679009792 + 12)
        self.assertEqual(lw.key_name(lw.make_key("b", 3)), "b3")
        with self.assertRaisesRegex(lw.InputError, "12x"):
            lw.key("12x")


class Graph(unittest.TestCase):
    def test_arrays(self):
        graph = square()
        self.assertEqual(len(graph), 9)
        self.assertEqual(graph.keys.dtype, np.uint64)
        self.assertEqual(graph.poses.shape, (9, 4, 4))
        edges = graph.edges
        self.assertEqual(edges["T_from_to"].shape, (8, 4, 4))
        np.testing.assert_allclose(edges["information"][3], np.diag([100.0] * 3 + [2500.0] * 3))
        moved = graph.copy()
        moved.poses = graph.poses + 0.0
        np.testing.assert_array_equal(moved.poses, graph.poses)

    def test_errors_name_the_key(self):
        graph = square()
        with self.assertRaisesRegex(lw.InputError, "a3"):
            graph.add_node("a3", np.eye(4))
        with self.assertRaisesRegex(lw.UnknownKeyError, "a77"):
            graph.index_of("a77")
        with self.assertRaisesRegex(lw.InputError, "indefinite"):
            graph.add_edge("a0", "a5", np.eye(4), information=-np.eye(6))
        with self.assertRaisesRegex(lw.InputError, "last row"):
            graph.add_node("a50", np.full((4, 4), 2.0))
        with self.assertRaisesRegex(lw.InputError, "either information or sigmas"):
            graph.add_edge("a0", "a5", np.eye(4))

    def test_values_of_another_shape_or_type(self):
        graph = square()
        one = [1.0] * 6
        for message, call in (
                ("edge a0 to a5: sigmas needs 6 values, found 3", lambda: graph.add_edge("a0", "a5", np.eye(4), sigmas=one[:3])),
                ("prior of a0: sigmas needs 6 values, found 1", lambda: graph.add_prior("a0", np.eye(4), sigmas=[1.0])),
                ("edge a0 to a5: information needs shape (6, 6), found (3, 3)",
                 lambda: graph.add_edge("a0", "a5", np.eye(4), information=np.eye(3))),
                ("node a70: the pose needs shape (4, 4), found (3, 4)", lambda: graph.add_node("a70", np.eye(4)[:3])),
                ("edge a0 to a5: the pose must be an array of numbers, found str", lambda: graph.add_edge("a0", "a5", "x", sigmas=one)),
                ("gravity at a0: direction needs 3 values, found 2", lambda: graph.add_gravity("a0", [0, 1], 0.1)),
                ("guess: the pose needs shape (4, 4), found (6,)", lambda: lw.align(np.eye(3), np.eye(3), guess=one)),
                ("a key is a name such as \"a12\" or a number in [0, 2^64), found -1", lambda: graph.index_of(-1)),
                ("a key is a name such as \"a12\" or a number in [0, 2^64), found 1.5", lambda: lw.key(1.5)),
                ("robots must be Robots or a text such as \"a,b\", found int", lambda: lw.propose(graph, robots=3)),
                ("poses must be a graph or a dictionary", lambda: lw.trajectory_errors(graph, 3)),
                ("node a0: the pose needs shape (4, 4), found (2,)", lambda: lw.trajectory_errors({"a0": [1, 2]}, graph)),
                ("Unable to cast", lambda: lw.replay(lw.read_mission(SAMPLE), prioritizers=[3]))):
            with self.subTest(message), self.assertRaises(lw.InputError) as raised:
                call()
            self.assertIn(message, str(raised.exception))

    def test_files(self):
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "graph.g2o"
            graph = square()
            lw.write_g2o(path, graph)
            again, problems = lw.read_g2o(path)
            self.assertEqual(problems, [])
            np.testing.assert_allclose(again.poses, graph.poses, atol=1e-14)
            with self.assertRaises(lw.IoError):
                lw.read_g2o(path.with_name("absent.g2o"))

    def test_planar(self):
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "plane.g2o"
            path.write_text("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0.5\n"
                            "EDGE_SE2 0 1 1 0 0.5 10 0 0 10 0 40\n")
            graph, problems = lw.read_g2o(path)
            self.assertEqual(problems, [])
            self.assertTrue(graph.planar)
            self.assertFalse(square().planar)
            tilted = np.eye(4)
            tilted[2, 3] = 1.0
            with self.assertRaisesRegex(lw.InputError, "the graph is planar"):
                graph.add_node(2, tilted)
            graph.planar = False
            graph.add_node(2, tilted)
            with self.assertRaisesRegex(lw.InputError, "node 2: pose has z"):
                graph.planar = True


class Optimization(unittest.TestCase):
    def test_closure_closes(self):
        graph = square()
        graph.add_edge("a8", "a0", np.eye(4), sigmas=[0.01] * 3 + [0.002] * 3)
        before = np.linalg.norm(graph.poses[8, :3, 3])
        result = lw.optimize(graph)
        self.assertTrue(result.converged)
        self.assertLess(np.linalg.norm(result.poses[8, :3, 3]), 0.1 * before)
        self.assertLess(result.cost, result.cost_initial)

    def test_begins_where_the_options_say(self):
        graph = square(drift=0.0)
        poses = graph.poses
        poses[4, 0, 3] += 1.0
        graph.poses = poses
        file = {"initialization": "file"}
        for optimize in (lw.optimize, lambda *arguments: lw.optimize_gnc(*arguments).optimization):
            self.assertGreater(optimize(graph, file).cost_initial, 1.0)
            self.assertLess(optimize(graph).cost_initial, 1.0)  # at the poses of odometry

    def test_gnc_finds_the_false_closure(self):
        graph = square(drift=0.0)
        graph.add_edge("a8", "a0", np.eye(4), sigmas=[0.1] * 3 + [0.02] * 3)
        graph.add_edge("a4", "a1", pose(30.0), sigmas=[0.1] * 3 + [0.02] * 3)
        result = lw.optimize_gnc(graph)
        np.testing.assert_array_equal(result.weights > 0.5, [True] * 9 + [False])
        self.assertEqual((result.inliers, result.outliers), (1, 1))

    def test_certify(self):
        graph = square(drift=0.02)
        graph.poses = lw.optimize(graph).poses
        result = lw.certify(graph)
        self.assertEqual(result.status, "certified")
        self.assertEqual(result.poses.shape, (9, 4, 4))
        self.assertLessEqual(result.lower_bound, result.cost)
        self.assertEqual((result.components, result.certified_components, result.reduced_factors), (1, 1, 0))

    def test_marginals(self):
        result = lw.marginals(square())
        self.assertEqual(result.covariances.shape, (9, 6, 6))
        np.testing.assert_allclose(np.trace(result.covariances[:, :3, :3], axis1=1, axis2=2).sum(),
                                   result.trace_translation)
        np.testing.assert_allclose(result.covariances[0], 1e-6 * np.eye(6), rtol=1e-6, atol=1e-15)

    def test_marginals_of_nodes_that_nothing_constrains(self):
        graph = square()
        graph.add_node("b0", pose())
        result = lw.marginals(graph)
        self.assertTrue(np.isnan(result.covariances[9]).all())
        self.assertFalse(np.isnan(result.covariances[:9]).any())
        self.assertEqual(result.trace_full, lw.marginals(square()).trace_full)
        graph.add_prior("b0", pose(), sigmas=[0.1] * 6)
        self.assertFalse(np.isnan(lw.marginals(graph).covariances).any())

    def test_options_are_checked(self):
        with self.assertRaisesRegex(lw.OptionError, "max_iterations"):
            lw.optimize(square(), {"max_iteration": 3})

    def test_options_by_section_or_of_the_section(self):
        graph = square()
        graph.add_edge("a8", "a0", np.eye(4), sigmas=[0.01] * 3 + [0.002] * 3)
        one_step = {"max_iterations": 1, "initialization": "file"}
        self.assertEqual(lw.optimize(graph, one_step).iterations, 1)
        self.assertEqual(lw.optimize(graph, {"optimization": one_step}).iterations, 1)
        both = {"optimization": {"threads": 1}, "gnc": {"inlier_probability": 0.9}}
        np.testing.assert_array_equal(lw.optimize_gnc(graph, both).weights,
                                      lw.optimize_gnc(graph, gnc={"inlier_probability": 0.9}).weights)
        with self.assertRaisesRegex(lw.OptionError, 'section "gnc" have no effect here: give those of "optimization"'):
            lw.optimize(graph, both)


class Registration(unittest.TestCase):
    def room(self, seed):
        rng = np.random.default_rng(seed)
        points = rng.uniform([-6, -4, -1], [6, 4, 2], (4000, 3))
        wall = rng.integers(0, 5, len(points))
        for k, (axis, value) in enumerate([(0, -6), (0, 6), (1, -4), (1, 4), (2, -1)]):
            points[wall == k, axis] = value
        box = rng.uniform([1, 0, -1], [3, 1.5, 0.5], (1500, 3))
        side = rng.integers(0, 4, len(box))
        for k, (axis, value) in enumerate([(0, 1), (0, 3), (1, 0), (1, 1.5)]):
            box[side == k, axis] = value
        return np.vstack([points, box]).astype(np.float32)

    def test_a_known_motion(self):
        truth = pose(0.8, -0.4, 0.0, 0.3)  # T_target_source
        target, world = self.room(1), self.room(2)
        source = (world - truth[:3, 3]) @ truth[:3, :3]
        result = lw.register(source, target)
        self.assertTrue(result["verified"], result["message"])
        np.testing.assert_allclose(result["T_target_source"], truth, atol=0.05)
        self.assertEqual(result["covariance"].shape, (6, 6))
        with self.assertRaisesRegex(lw.InputError, "row 7 is not finite"):
            source[7, 1] = np.nan
            lw.register(source, target)
        with self.assertRaisesRegex(lw.InputError, "shape"):
            lw.register(source[:, :2], target)

    def test_align(self):
        truth = pose(0.8, -0.4, 0.0, 0.3)  # T_target_source
        target, world = self.room(1), self.room(2)
        source = (world - truth[:3, 3]) @ truth[:3, :3]
        result = lw.align(target, source)
        self.assertTrue(result.success, result.message)
        self.assertEqual(result.reason, "")
        np.testing.assert_allclose(result.T_target_source, truth, atol=0.05)
        same = lw.register(source, target)
        np.testing.assert_array_equal(result.T_target_source, same["T_target_source"])
        np.testing.assert_array_equal(result.covariance, same["covariance"])
        self.assertTrue(0.5 < result.inlier_share <= 1.0)
        holes = np.vstack([source, [[np.nan, 0, 0]]])
        again = lw.align(target, holes, guess=truth)
        self.assertTrue(again.success, again.message)
        self.assertEqual((again.dropped_target_points, again.dropped_source_points), (0, 1))
        failed = lw.align(target, source[:5])
        self.assertEqual((failed.success, failed.reason), (False, "too_few_points"))
        self.assertTrue(np.isnan(failed.T_target_source[:3]).all() and np.isnan(failed.covariance).all())
        self.assertIn("too_few_points", repr(failed))
        with self.assertRaisesRegex(lw.InputError, "source must be an array of shape"):
            lw.align(target, source[:, :2])
        with self.assertRaisesRegex(lw.OptionError, "voxel_m"):
            lw.align(target, source, options={"features": {"voxel_m": -1}})


class Prioritization(unittest.TestCase):
    def setUp(self):
        self.graph = square(40)
        self.candidates = lw.propose(self.graph, options={"skip_recent": 5, "radius_min_m": 8.0, "radius_max_m": 8.0})

    def test_gains_are_those_of_adding_the_closure(self):
        self.assertGreater(len(self.candidates), 20)
        gains = lw.exact_gains(self.graph, self.candidates)
        base = lw.marginals(self.graph).trace_translation
        for candidate, gain in list(zip(self.candidates, gains))[::7]:
            graph = self.graph.copy()
            i, j = graph.index_of(candidate.from_key), graph.index_of(candidate.to_key)
            graph.add_edge(candidate.from_key, candidate.to_key, np.linalg.inv(graph.poses[i]) @ graph.poses[j],
                           sigmas=[0.1] * 3 + [0.02] * 3)
            self.assertAlmostEqual(base - lw.marginals(graph).trace_translation, gain, delta=1e-6 * base)

    def test_methods(self):
        for method in ("baseline", "random", "gi"):
            prioritizer = lw.make_prioritizer(method, lw.Robots("a"))
            prioritizer.on_graph(self.graph)
            self.assertEqual(prioritizer.add(self.candidates), [])
            prioritizer.improve(5, 200)
            taken = prioritizer.take(5)
            self.assertEqual(len(taken), 5)
            self.assertEqual(len(prioritizer), len(self.candidates) - 5)
        self.assertEqual([c.id for c in lw.make_prioritizer("baseline", lw.Robots("a")).take(1)], [])
        with self.assertRaisesRegex(lw.OptionError, "full"):
            lw.make_prioritizer("best", lw.Robots("a"))


class Newest(lw.Prioritizer):
    """Last generated, first computed."""

    def __init__(self):
        super().__init__()
        self.held = {}
        self.results = 0

    def name(self):
        return "newest"

    def add(self, candidates):
        self.held.update({c.id: c for c in candidates})

    def remove(self, ids):
        for i in ids:
            self.held.pop(i, None)

    def on_result(self, result):
        self.results += 1

    def take(self, count):
        return [self.held.pop(i) for i in sorted(self.held, reverse=True)[:count]]

    def size(self):
        return len(self.held)


class Replay(unittest.TestCase):
    CONFIG = {"replay": {"batch": 20}, "cost": {"registration_time_s": 13.0}}

    def setUp(self):
        self.mission = lw.read_mission(SAMPLE)

    def test_a_mission(self):
        self.assertEqual(len(self.mission.robots), 2)
        scan = self.mission.scan(int(self.mission.scan_keys[0]))
        self.assertEqual(scan["points"].shape[1], 3)
        stages = []
        run = lw.replay(self.mission, method="random", config=self.CONFIG, progress=lambda *p: stages.append(p[0]))
        self.assertTrue(stages)
        closures = run.closures
        self.assertEqual(closures["T_from_to"].shape, (len(closures["from"]), 4, 4))
        self.assertEqual(run.summary["closures"]["verified"], int(closures["verified"].sum()))
        errors = lw.trajectory_errors(run.graph, self.mission.ground_truth)
        self.assertAlmostEqual(errors["ate_m"]["mean"], run.summary["ate_m"]["optimized"], places=12)
        again = lw.replay(self.mission, method="random", config=self.CONFIG, threads=2)
        np.testing.assert_array_equal(again.graph.poses, run.graph.poses)
        with tempfile.TemporaryDirectory() as folder:
            run.write(pathlib.Path(folder) / "out", map_voxel_m=0)
            summary = json.loads((pathlib.Path(folder) / "out" / "summary.json").read_text())
            self.assertEqual(summary["closures"], run.summary["closures"])

    def test_what_a_map_lacks_is_written(self):
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "m"
            shutil.copytree(SAMPLE, path)
            broken = sorted((path / "scans").iterdir())[3]
            broken.write_text("no cloud")
            run = lw.replay(lw.read_mission(path), method="odom")  # reads no scan
            run.write(pathlib.Path(folder) / "out")
            summary = json.loads((pathlib.Path(folder) / "out" / "summary.json").read_text())
            self.assertTrue(any(broken.stem in problem for problem in summary["problems"]), summary["problems"])

    def test_truth_from_files(self):
        truth = lw.PoseGraph()
        for key, T in self.mission.ground_truth.items():
            truth.add_node(key, pose(3.0, yaw=0.1) @ T)
        with tempfile.TemporaryDirectory() as folder:
            path = str(pathlib.Path(folder) / "truth.g2o")
            lw.write_g2o(path, truth)
            self.assertFalse(self.mission.truth_is_aligned)
            lw.set_truth(self.mission, [path])
        self.assertTrue(self.mission.truth_is_aligned)
        with self.assertRaisesRegex(lw.OptionError, "no robot"):
            lw.set_truth(self.mission, ["nobody=truth.tum"])

    def test_a_prioritizer_in_python(self):
        own = Newest()
        run = lw.replay(self.mission, config=self.CONFIG, prioritizers=[own])
        times = run.closures["mission_time_s"]
        self.assertEqual(own.results, len(times))
        self.assertGreater(own.results, 0)
        baseline = lw.replay(self.mission, method="baseline", config=self.CONFIG)
        self.assertNotEqual(run.closures["from"].tolist(), baseline.closures["from"].tolist())
        for used in ([own], [(new := Newest()), new]):
            with self.assertRaisesRegex(lw.InputError, 'prioritizer "newest" has been used before: make a new object'):
                lw.replay(self.mission, config=self.CONFIG, prioritizers=used)

    def test_exceptions_of_python_come_through(self):
        class Broken(Newest):
            def take(self, count):
                raise ValueError("no candidates today")

        with self.assertRaisesRegex(ValueError, "no candidates today"):
            lw.replay(self.mission, config=self.CONFIG, prioritizers=[Broken()])
        with self.assertRaisesRegex(KeyError, "stop here"):
            def progress(*_):
                raise KeyError("stop here")
            lw.replay(self.mission, method="baseline", config=self.CONFIG, progress=progress)


class Documentation(unittest.TestCase):
    def test_the_quickstarts_run(self):
        for page in (SOURCE / "README.md", SOURCE / "docs" / "python.md"):
            program = page.read_text().split("```python\n", 1)[1].split("```", 1)[0]
            with self.subTest(page=page.name):
                subprocess.run([sys.executable, "-c", program], cwd=SOURCE, check=True, stdout=subprocess.DEVNULL)

    def test_the_recipes_run(self):
        recipes = SOURCE / "docs" / "examples" / "recipes"
        clouds = sorted((SAMPLE / "scans").glob("*.pcd"))[:2]
        graph = SOURCE / "tests" / "package" / "circle.g2o"
        programs = {"align_clouds.py": clouds, "robust_g2o.py": [graph], "replay_methods.py": [SAMPLE]}
        self.assertEqual(sorted(path.name for path in recipes.glob("*.py")), sorted(programs))
        for name, arguments in programs.items():
            with self.subTest(name):
                run = subprocess.run([sys.executable, recipes / name, *arguments], check=True, capture_output=True, text=True)
                self.assertNotEqual(run.stdout, "")
                if name == "robust_g2o.py":
                    self.assertIn("false closure: 3 - 9\n3 closures kept", run.stdout)

    def test_the_page_lists_the_exceptions(self):
        page = (SOURCE / "docs" / "python.md").read_text()
        for name in dir(lw):
            if isinstance(getattr(lw, name), type) and issubclass(getattr(lw, name), Exception):
                self.assertIn(f"`{name}`", page)

    def test_the_stubs_name_everything(self):
        stubs = (pathlib.Path(lw.__file__).parent / "_loopwise.pyi").read_text()
        for name in dir(lw):
            if not name.startswith("_"):
                self.assertRegex(stubs, rf"(?m)^(def|class) {name}\b", name)
        for cls in (lw.PoseGraph, lw.Mission, lw.Run, lw.Prioritizer, lw.LoopCandidate, lw.RegistrationResult,
                    lw.AlignResult):
            body = stubs.split(f"class {cls.__name__}", 1)[1].split("\nclass ", 1)[0]
            for name in dir(cls):
                if not name.startswith("_"):
                    self.assertRegex(body, rf"\b{name}\b", f"{cls.__name__}.{name}")


if __name__ == "__main__":
    unittest.main()
