"""Features of images with numpy alone, for policies with encoders; see `portable`, beside which this file belongs.

It does what `nets.encoder.Encoder` does.
"""

import numpy as np

SIDES = (4, 2, 2)  # of the squares of pixels
STRIDES = (2, 1, 1, 1)
STAGES = 3


def features(node, arrays, pictures):
    """(n, features) float32 of (n, height, width, channels) pictures, numbers from 0 to 255.

    `node` is the encoder's part of a policy's tree, and `arrays` those of its file. ValueError where pictures are of another
    shape, or not of uint8.
    """
    if pictures.dtype != np.uint8:
        raise ValueError(f"this policy takes images of uint8, numbers from 0 to 255, got {pictures.dtype}")
    shape = tuple(node["shape"])
    if pictures.shape[1:] != shape:
        raise ValueError(f"this policy takes images of shape {shape}, got {pictures.shape[1:]}")
    layers = [(arrays[kernel[1:]], arrays[bias[1:]]) for kernel, bias in zip(node["kernels"], node["biases"])]
    x = _maps(node["network"], layers[:-1], pictures.astype(np.float32) / np.float32(255.0) - np.float32(0.5))
    out = x.reshape(len(x), -1) @ layers[-1][0] + layers[-1][1]
    out = out - out.mean(-1, keepdims=True)
    return np.tanh(out / np.sqrt(np.square(out).mean(-1, keepdims=True) + 1e-6))


def _maps(network, layers, x):
    if network == "patches":
        for side, (kernel, bias) in zip(SIDES, layers):
            x = np.maximum(_patches(x, side) @ kernel + bias, 0.0)
        return x
    if network == "drq":
        for stride, (kernel, bias) in zip(STRIDES, layers):
            x = np.maximum(_convolved(x, kernel, stride) + bias, 0.0)
        return x
    if network != "impala":
        raise ValueError(f"unknown network for images {network!r}")
    left = iter(layers)
    for _ in range(STAGES):
        x = _pooled(_same(x, *next(left)))
        for _ in range(2):
            inner = _same(np.maximum(x, 0.0), *next(left))
            x = x + _same(np.maximum(inner, 0.0), *next(left))
    return np.maximum(x, 0.0)


def _patches(x, side):
    """Squares of pixels as one row each; pictures are filled up with zeros below and to the right."""
    n, height, width, channels = x.shape
    down, across = -(-height // side), -(-width // side)
    x = np.pad(x, ((0, 0), (0, down * side - height), (0, across * side - width), (0, 0)))
    x = x.reshape(n, down, side, across, side, channels).transpose(0, 1, 3, 2, 4, 5)
    return x.reshape(n, down, across, side * side * channels)


def _convolved(x, kernel, stride):
    """3 x 3 convolution without a margin."""
    height, width = x.shape[1] - 2, x.shape[2] - 2
    total = 0.0
    for row in range(3):
        for column in range(3):
            total = total + x[:, row : row + height : stride, column : column + width : stride] @ kernel[row, column]
    return total


def _same(x, kernel, bias):
    return _convolved(np.pad(x, ((0, 0), (1, 1), (1, 1), (0, 0))), kernel, 1) + bias


def _pooled(x):
    """The largest of 3 x 3 at every second place, with the margins that JAX has for "SAME"."""
    margins = [(0, 0)]
    for size in x.shape[1:3]:
        missing = max((-(-size // 2) - 1) * 2 + 3 - size, 0)
        margins.append((missing // 2, missing - missing // 2))
    x = np.pad(x, [*margins, (0, 0)], constant_values=-np.inf)
    height, width = x.shape[1] - 2, x.shape[2] - 2
    parts = [x[:, r : r + height : 2, c : c + width : 2] for r in range(3) for c in range(3)]
    return np.maximum.reduce(parts)
