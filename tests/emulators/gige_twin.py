"""The twin behind Aravis's emulated GigE Vision camera: frames of its pins over the network.

``python gige_twin.py SCENE LEAD_NS CODE_NS LENGTH_PX`` prints the controller's port and the side
of the frames in px, and then the file of each frame's code values, until its standard input ends.
"""

import os
import sys
import tempfile
from pathlib import Path

import numpy as np

from cep.shutter.twin import TwinCamera
from emulators.gige_camera import serve
from hw.cameras.camera import CameraSettings
from motdiff.trajectory import Trajectory


def say(line):
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def main(scene, lead_ns, code_ns, length_px):
    folder = Path(tempfile.mkdtemp())
    with TwinCamera.open(f"scene={scene}") as twin:
        twin.moves(
            Trajectory.straight(float(length_px), direction="known"),
            start_s=int(lead_ns) * 1e-9,
            duration_s=int(code_ns) * 1e-9,
        )
        count = 0

        def fill(width, height, exposure_us, _gain):
            """Expose: the output "exposure active" triggers the emulated controller."""
            nonlocal count
            twin.configure(CameraSettings(exposure_s=exposure_us * 1e-6))
            twin.arm()
            twin.fire()
            frame = twin.read(5)
            if frame.values.shape != (height, width):
                os._exit(1)  # C swallows an exception, and the test would wait for its frame
            count += 1
            np.save(folder / f"{count}.npy", frame.values)
            say(folder / f"{count}.npy")
            return frame.values.tobytes()

        camera = serve(fill)
        say(f"{twin.uno.port} {twin.scene.rows}")
        sys.stdin.read()
        del camera


if __name__ == "__main__":
    main(*sys.argv[1:])
