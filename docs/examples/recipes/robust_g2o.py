# SPDX-License-Identifier: BSD-3-Clause
"""robust_g2o.py GRAPH: false closures of a g2o file, and how certain the poses are without them."""
import sys

import numpy as np

import loopwise as lw

graph, problems = lw.read_g2o(sys.argv[1])
robust = lw.optimize_gnc(graph)
graph.poses = robust.poses
graph.set_weights(robust.weights)
edges = graph.edges
for a, b, kind, weight in zip(edges["from"], edges["to"], edges["kind"], robust.weights):
    if kind == lw.EdgeKind.LOOP_CLOSURE and weight < 0.5:
        print("false closure:", lw.key_name(a), "-", lw.key_name(b))
covariance = lw.marginals(graph).covariances[-1]
print(f"{robust.inliers} closures kept; sigma of the last node: {np.sqrt(np.trace(covariance[:3, :3])):.3f} m")
