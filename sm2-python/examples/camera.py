"""A camera: publishes images, which no process copies. Run it beside detector.py and viewer.py."""

import sys

import numpy as np

import sm2

HEIGHT, WIDTH = 1080, 1920


def main(images: int) -> None:
    """Publishes so many images, 30 in each second."""
    with sm2.Node("camera", standby_manager=True) as node:
        publisher = node.publisher("camera/image", "u1")
        for tick in sm2.Timer.hz(30):
            with publisher.loan((HEIGHT, WIDTH, 3)) as image:
                draw(image, tick.number)
            if tick.number >= images:
                break


def draw(image: np.ndarray, number: int) -> None:
    """Draws a bright square, which moves to the right, on a dark ground."""
    left = 20 * number % (WIDTH - 100)
    image[:] = 16
    image[500:600, left : left + 100] = 240


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 300)
