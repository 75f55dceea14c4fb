"""Decimated meshes for small pictures."""

import copy

import fast_simplification
import numpy as np

from acgd.tasks.simulator import mujoco


def decimated(model: mujoco.MjModel, drawn: set[int], faces: int) -> mujoco.MjModel:
    """A copy of `model` whose meshes `drawn` have at most about `faces` triangles each, and other meshes none.

    Indices, frames and materials stay those of `model`, so that a scene of `model` can be rendered with the meshes of
    the copy. The copy is for rendering only.
    """
    small = copy.copy(model)
    small.mesh_graphadr[:] = -1  # convex hulls and textures refer to the original vertices
    small.mesh_texcoordadr[:] = -1
    for i in range(model.nmesh):
        if i not in drawn:
            small.mesh_facenum[i] = 0
            continue
        first, count = model.mesh_vertadr[i], model.mesh_vertnum[i]
        first_face, face_count = model.mesh_faceadr[i], model.mesh_facenum[i]
        points = model.mesh_vert[first : first + count]
        triangles = model.mesh_face[first_face : first_face + face_count]
        if face_count > faces:
            points, triangles = fast_simplification.simplify(points.copy(), triangles.copy(), target_count=faces)
        vertices, normals = len(points), small.mesh_normaladr[i]
        small.mesh_vertnum[i] = small.mesh_normalnum[i] = vertices
        small.mesh_facenum[i] = len(triangles)
        small.mesh_vert[first : first + vertices] = points
        small.mesh_normal[normals : normals + vertices] = smooth_normals(points, triangles)
        small.mesh_face[first_face : first_face + len(triangles)] = triangles
        small.mesh_facenormal[first_face : first_face + len(triangles)] = triangles
    return small


def smooth_normals(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """points (V, 3), triangles (F, 3) -> unit normals (V, 3): area-weighted means over adjoining triangles."""
    a, b, c = (points[triangles[:, corner]] for corner in range(3))
    across = np.cross(b - a, c - a)
    normals = np.zeros((len(points), 3))
    for corner in range(3):
        np.add.at(normals, triangles[:, corner], across)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
