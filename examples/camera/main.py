"""Camera: pictures as fresh as the link allows. On Wi-Fi they are large and good, over Bluetooth small, by themselves.

python examples/camera/main.py wombat-1              # shows pictures to whoever watches
python examples/camera/main.py laptop wombat-1       # watches
"""

import sys
import time

import numpy as np
import rect

ROWS, COLUMNS = np.mgrid[0:240, 0:320]


def seen(n: int) -> np.ndarray:
    """What a camera would see: a bright ball that goes round before a grey wall."""
    x, y = 160 + 80 * np.cos(n / 10), 120 + 80 * np.sin(n / 10)
    picture = np.stack([np.full((240, 320), 90), np.full((240, 320), 90), 90 + ROWS // 4], axis=-1)
    picture[np.hypot(COLUMNS - x, ROWS - y) < 20] = [250, 200, 30]
    return picture.astype(np.uint8)


def main(me: str = "wombat-1", other: str = "") -> None:
    with rect.connect(me) as robot:
        if other:
            for frame in robot.watch(other, "camera"):
                print(f"frame {frame.number}: {frame.value}, {frame.age} s old, {frame.skipped} skipped", flush=True)
        camera = robot.stream("camera")
        for n in range(2**62):
            camera.send(seen(n))
            time.sleep(0.05)


if __name__ == "__main__":
    main(*sys.argv[1:])
