"""A viewer: prints images and detections as they come, in an asyncio loop."""

import asyncio

from detector import DETECTION, SHAPE

import sm2


async def show_images(node: sm2.Node) -> None:
    """Prints the brightness of each tenth image."""
    async for sample in node.subscriber("camera/image", "u1", keep_last=1):
        if sample.sequence % 10 == 0:
            image = sample.numpy("u1", SHAPE)
            print(f"image {sample.sequence}: {image.shape}, mean {image[::8, ::8].mean():.1f}")


async def show_detections(node: sm2.Node) -> None:
    """Prints each detection."""
    async for sample in node.subscriber("vision/detections", DETECTION):
        found = sample.value
        print(f"image {found['image']}: square at {found['x']}, {found['y']}")


async def main() -> None:
    """Shows both until Ctrl-C."""
    with sm2.Node("viewer", startup_timeout=60) as node:
        await asyncio.gather(show_images(node), show_detections(node))


if __name__ == "__main__":
    try:
        asyncio.run(main())
    except KeyboardInterrupt:
        pass
