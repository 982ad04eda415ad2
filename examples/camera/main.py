"""Camera: sends pictures as a stream. Their size and quality adapt to the link: large over Wi-Fi, small over Bluetooth.

python examples/camera/main.py wombat-1              # sends pictures
python examples/camera/main.py laptop wombat-1       # receives them
"""

import sys
import time
from contextlib import suppress

import numpy as np
import rect

ROWS, COLUMNS = np.mgrid[0:240, 0:320]


def take_picture(n: int) -> np.ndarray:
    """Returns picture `n` of a simulated camera: a bright ball that circles in front of a grey wall."""
    x, y = 160 + 80 * np.cos(n / 10), 120 + 80 * np.sin(n / 10)
    picture = np.stack([np.full((240, 320), 90), np.full((240, 320), 90), 90 + ROWS // 4], axis=-1)
    picture[np.hypot(COLUMNS - x, ROWS - y) < 20] = [250, 200, 30]
    return picture.astype(np.uint8)


def main(me: str = "wombat-1", other: str = "") -> None:
    with rect.connect(me) as robot:
        if other:
            for frame in robot.watch(f"{other}/camera"):
                number, age, skipped = frame.number, frame.age, frame.skipped
                print(f"frame {number}: {frame.value}, {age} s old, {skipped} frames skipped", flush=True)
        camera = robot.stream("camera")
        for n in range(2**62):
            camera.send(take_picture(n))
            time.sleep(0.05)


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        main(*sys.argv[1:])
