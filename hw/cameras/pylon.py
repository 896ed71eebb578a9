"""Basler cameras, and Basler's emulated ones (``PYLON_CAMEMU=1``), through pypylon."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, ClassVar, Self

from hw.cameras.camera import CameraError, ConnectedCamera, Frame, FrameLostError, choose_camera
from hw.cameras.genicam import GenicamCamera, Value
from hw.errors import one_line


class PylonCamera(GenicamCamera):
    """A Basler camera.

    Parameters
    ----------
    device : pypylon.pylon.InstantCamera
        Open, owned by the camera from now on.
    """

    name: ClassVar[str] = "pylon"
    summary: ClassVar[str] = "Basler, GigE or USB: pip install coded-exposure[pylon]"

    def __init__(self, device: Any) -> None:
        about = device.GetDeviceInfo()
        super().__init__(
            _PylonFeatures(device),
            camera=f"Basler {about.GetModelName()}",
            serial=about.GetSerialNumber(),
        )
        self._device = device

    @classmethod
    def open(cls, address: str) -> Self:
        """Open the camera of a serial number, user-defined name or IP; the only one if empty."""
        try:
            from pypylon import genicam, pylon
        except ImportError:
            raise ValueError(
                "pylon: pypylon is not installed: pip install coded-exposure[pylon]"
            ) from None
        factory = pylon.TlFactory.GetInstance()
        listed = factory.EnumerateDevices()
        connected = [
            ConnectedCamera(
                about.GetModelName(),
                tuple(
                    filter(
                        None,
                        (
                            about.GetSerialNumber(),
                            about.GetUserDefinedName(),
                            about.GetIpAddress() if about.IsIpAddressAvailable() else "",
                            about.GetModelName(),
                        ),
                    )
                ),
            )
            for about in listed
        ]
        index = choose_camera(cls.name, address, connected)
        try:
            device = pylon.InstantCamera(factory.CreateDevice(listed[index]))
            # instead of pylon's own, which switches off all triggers as the camera is opened
            device.RegisterConfiguration(
                pylon.ConfigurationEventHandler(),
                pylon.RegistrationMode_ReplaceAll,
                pylon.Cleanup_Delete,
            )
            device.Open()
        except genicam.GenericException as error:
            raise ValueError(
                f"{cls.name}: {connected[index]} cannot be opened, close the program that uses"
                f" it: {one_line(error)}"
            ) from None
        return cls(device)

    def wait_ready(self, timeout_s: float) -> None:
        """Wait for the camera's own FrameTriggerWait, where it has it."""
        from pypylon import pylon

        with _errors():
            if not self._device.CanWaitForFrameTriggerReady():
                super().wait_ready(timeout_s)
            elif not self._device.WaitForFrameTriggerReady(
                round(timeout_s * 1e3), pylon.TimeoutHandling_Return
            ):
                raise self._not_ready(timeout_s)

    def read(self, timeout_s: float) -> Frame:
        """Wait for the frame of the last trigger."""
        from pypylon import pylon

        with _errors():
            result = self._device.RetrieveResult(
                round(timeout_s * 1e3), pylon.TimeoutHandling_Return
            )
            # no result at all: no frame came, or the camera is gone
            if not result.IsValid():
                self._gone = self._device.IsCameraDeviceRemoved()
                if self._gone:
                    raise CameraError(f"{self.camera} {self.serial} is gone: check its cable")
                raise self._no_frame(timeout_s)
            with result:
                if not result.GrabSucceeded():
                    raise FrameLostError(
                        f"{self.camera}: incomplete frame {result.BlockID}:"
                        f" {result.GetErrorDescription()}"
                    )
                return self._frame(
                    bytes(result.Buffer),
                    shape=(result.Height, result.Width),
                    padding=result.PaddingX,
                    block=result.BlockID,
                    timestamp_ns=result.TimeStamp,
                )

    def _start(self) -> None:
        with _errors():
            self._device.StartGrabbing()

    def _stop(self) -> None:
        with _errors():
            self._device.StopGrabbing()

    def _drop(self) -> None:
        from pypylon import pylon

        with _errors():
            while self._device.RetrieveResult(0, pylon.TimeoutHandling_Return).IsValid():
                pass

    def _release(self) -> None:
        self._device.Close()


class _PylonFeatures:
    def __init__(self, device: Any) -> None:
        self._nodes = device.GetNodeMap()

    def available(self, name: str) -> bool:
        from pypylon import genicam

        with _errors():
            return bool(genicam.IsReadable(self._nodes.GetNode(name)))

    def get(self, name: str) -> Value:
        with _errors():
            value: Value = self._nodes.GetNode(name).Value
            return value

    def set(self, name: str, value: Value) -> None:
        with _errors():
            self._nodes.GetNode(name).Value = value

    def entries(self, name: str) -> tuple[str, ...]:
        from pypylon import genicam

        with _errors():
            return tuple(
                entry.GetSymbolic()
                for entry in self._nodes.GetNode(name).GetEntries()
                if genicam.IsAvailable(entry)
            )

    def bounds(self, name: str) -> tuple[float, float]:
        with _errors():
            node = self._nodes.GetNode(name)
            return node.Min, node.Max

    def unit(self, name: str) -> str:
        with _errors():
            return str(self._nodes.GetNode(name).GetUnit())

    def execute(self, name: str) -> None:
        with _errors():
            self._nodes.GetNode(name).Execute()


@contextmanager
def _errors() -> Iterator[None]:
    """Raise Basler's errors as CameraError, one line each."""
    from pypylon import genicam

    try:
        yield
    except genicam.GenericException as error:
        raise CameraError(one_line(error)) from None
