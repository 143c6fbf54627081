"""Turn matrices to the axes forward, left and up."""

from cfid.records.rig_file import BodyFrame


def axis_of(name: str) -> tuple[int, int]:
    """Return the index of a body axis in x, y, z, and its sign."""
    return "xyz".index(name[-1]), -1 if name.startswith("-") else 1


def turned(matrix: list[list[float]], frame: BodyFrame) -> dict[str, float]:
    """Return the entries of a symmetric matrix (3, 3) of a body frame, turned to the axes forward, left and up.

    Roll is about forward, pitch about left, yaw about up. Products of inertia remain entries of the matrix, with its
    sign convention.
    """
    axes = {"roll": axis_of(frame.forward), "pitch": axis_of(frame.left), "yaw": axis_of(frame.up)}
    names = [("roll", "roll"), ("pitch", "pitch"), ("yaw", "yaw"), ("roll", "pitch"), ("roll", "yaw"), ("pitch", "yaw")]
    result = {}
    for first, second in names:
        (i, sign_i), (j, sign_j) = axes[first], axes[second]
        result[first if first == second else f"{first}-{second}"] = sign_i * sign_j * matrix[i][j]
    return result
