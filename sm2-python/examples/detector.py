"""A detector: finds the bright square in each image of camera.py, and publishes its place."""

import numpy as np

import sm2

SHAPE = (-1, 1920, 3)

#: In Rust: a structure with these fields, `repr(C)` and `#[message(name = "vision/Detection")]`.
DETECTION = sm2.Plain(
    [("image", "u8"), ("x", "u4"), ("y", "u4"), ("width", "u4"), ("height", "u4")],
    name="vision/Detection",
)


def main() -> None:
    """Detects until Ctrl-C."""
    with sm2.Node("detector", startup_timeout=60) as node:
        # Only the newest image is of interest.
        images = node.subscriber("camera/image", "u1", keep_last=1, max_borrowed=1)
        detections = node.publisher("vision/detections", DETECTION)
        for sample in images:
            image = sample.numpy("u1", SHAPE)
            rows, columns = np.nonzero(image[::4, ::4, 0] > 128)
            if rows.size:
                x, y = 4 * columns.min(), 4 * rows.min()
                width, height = 4 * np.ptp(columns) + 4, 4 * np.ptp(rows) + 4
                detections.publish((sample.sequence, x, y, width, height))
            # The camera gets the memory back before this program waits for the next image.
            del image, sample


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        pass
