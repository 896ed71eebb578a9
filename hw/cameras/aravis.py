"""GigE Vision and USB3 Vision cameras of any maker, through the system's Aravis library.

Of Aravis 0.8 only its C functions are used, by ctypes: a virtual environment sees no packages of
GObject's introspection, and the library is on every distribution.
"""

from __future__ import annotations

import ctypes
import threading
from ctypes import POINTER, byref, c_char_p, c_double, c_int, c_int64, c_size_t, c_uint, c_uint64
from ctypes import c_void_p as pointer
from functools import cache
from typing import Any, ClassVar, Self

from hw.cameras.camera import CameraError, ConnectedCamera, Frame, FrameLostError, choose_camera
from hw.cameras.genicam import GenicamCamera, Value

_FILES = ("libaravis-0.8.so.0", "libaravis-0.8.0.dylib", "libaravis-0.8-0.dll")
_BUFFERS = 8
_STATUS = {  # of ArvBuffer; 0 is a whole frame
    2: "timed out",
    3: "packets are missing",
    4: "a packet had a wrong number",
    5: "larger than announced",
    7: "acquisition was stopped",
    8: "payload of another kind than an image",
}
_REMEDY = "sudo apt-get install libaravis-0.8-0, or your system's Aravis 0.8"


class _GError(ctypes.Structure):
    _fields_: ClassVar = [("domain", ctypes.c_uint32), ("code", c_int), ("message", c_char_p)]


# functions that report an error, by a last argument that is not listed: result and arguments
_FALLIBLE: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "camera_new": (pointer, (c_char_p,)),
    "camera_create_stream": (pointer, (pointer, pointer, pointer)),
    "camera_get_payload": (c_uint, (pointer,)),
    "camera_start_acquisition": (None, (pointer,)),
    "camera_stop_acquisition": (None, (pointer,)),
    "device_is_feature_available": (c_int, (pointer, c_char_p)),
    "device_get_string_feature_value": (c_char_p, (pointer, c_char_p)),
    "device_set_string_feature_value": (None, (pointer, c_char_p, c_char_p)),
    "device_get_float_feature_value": (c_double, (pointer, c_char_p)),
    "device_set_float_feature_value": (None, (pointer, c_char_p, c_double)),
    "device_get_integer_feature_value": (c_int64, (pointer, c_char_p)),
    "device_set_integer_feature_value": (None, (pointer, c_char_p, c_int64)),
    "device_get_boolean_feature_value": (c_int, (pointer, c_char_p)),
    "device_set_boolean_feature_value": (None, (pointer, c_char_p, c_int)),
    "device_get_float_feature_bounds": (
        None,
        (pointer, c_char_p, POINTER(c_double), POINTER(c_double)),
    ),
    "device_dup_available_enumeration_feature_values_as_strings": (
        POINTER(c_char_p),
        (pointer, c_char_p, POINTER(c_uint)),
    ),
    "device_execute_command": (None, (pointer, c_char_p)),
    "device_read_register": (None, (pointer, c_uint64, POINTER(ctypes.c_uint32))),
}
_INFALLIBLE: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "update_device_list": (None, ()),
    "get_n_devices": (c_uint, ()),
    "get_device_id": (c_char_p, (c_uint,)),
    "get_device_physical_id": (c_char_p, (c_uint,)),
    "get_device_address": (c_char_p, (c_uint,)),
    "get_device_model": (c_char_p, (c_uint,)),
    "get_device_vendor": (c_char_p, (c_uint,)),
    "get_device_serial_nbr": (c_char_p, (c_uint,)),
    "camera_get_device": (pointer, (pointer,)),
    "camera_is_gv_device": (c_int, (pointer,)),
    "gv_device_is_controller": (c_int, (pointer,)),
    "device_get_feature": (pointer, (pointer, c_char_p)),
    "gc_enumeration_get_type": (c_size_t, ()),
    "gc_boolean_get_type": (c_size_t, ()),
    "gc_float_get_type": (c_size_t, ()),
    "gc_float_get_unit": (c_char_p, (pointer,)),
    "stream_push_buffer": (None, (pointer, pointer)),
    "stream_timeout_pop_buffer": (pointer, (pointer, c_uint64)),
    "stream_try_pop_buffer": (pointer, (pointer,)),
    "buffer_new_allocate": (pointer, (c_size_t,)),
    "buffer_get_status": (c_int, (pointer,)),
    "buffer_get_data": (pointer, (pointer, POINTER(c_size_t))),
    "buffer_get_image_width": (c_int, (pointer,)),
    "buffer_get_image_height": (c_int, (pointer,)),
    "buffer_get_image_padding": (None, (pointer, POINTER(c_int), POINTER(c_int))),
    "buffer_get_frame_id": (c_uint64, (pointer,)),
    "buffer_get_timestamp": (c_uint64, (pointer,)),
}


class _Library:
    """Functions of Aravis; one that reports an error raises CameraError."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._functions = {}
        for name, (result, arguments) in (_FALLIBLE | _INFALLIBLE).items():
            function = getattr(library, f"arv_{name}")
            function.restype = result
            extra = (pointer,) if name in _FALLIBLE else ()
            function.argtypes = (*arguments, *extra)
            self._functions[name] = function
        # of GLib, which the library itself has loaded
        self.unref = library.g_object_unref
        self.unref.argtypes = [pointer]
        self.free = library.g_free
        self.free.argtypes = [pointer]
        self._free_error = library.g_error_free
        self._free_error.argtypes = [pointer]
        self.is_a = library.g_type_check_instance_is_a
        self.is_a.argtypes = [pointer, c_size_t]

    def __call__(self, name: str, *arguments: Any) -> Any:
        function = self._functions[name]
        if name not in _FALLIBLE:
            return function(*arguments)
        error = POINTER(_GError)()
        result = function(*arguments, byref(error))
        if error:
            message = (error.contents.message or b"").decode(errors="replace")
            self._free_error(error)
            raise CameraError(" ".join(message.split())[:160] or f"Aravis: {name} failed")
        return result


@cache
def _library() -> _Library:
    for file in _FILES:
        try:
            return _Library(ctypes.CDLL(file))
        except OSError:
            continue
        except AttributeError as error:
            raise ValueError(f"aravis: {file} is too old ({error}): {_REMEDY}") from None
    raise ValueError(f"aravis: the Aravis library is not installed: {_REMEDY}")


class AravisCamera(GenicamCamera):
    """A GigE Vision or USB3 Vision camera.

    Parameters
    ----------
    handle : int
        Pointer to an ArvCamera, owned by the camera from now on.
    camera, serial : str
        Model and serial number.
    """

    name: ClassVar[str] = "aravis"
    summary: ClassVar[str] = f"any GigE Vision or USB3 Vision camera: {_REMEDY}"

    def __init__(self, handle: int, *, camera: str, serial: str) -> None:
        self._call = _library()
        self._handle: int | None = handle
        self._device: int = self._call("camera_get_device", handle)
        self._stream: int | None = None
        super().__init__(_AravisFeatures(self._call, self._device), camera=camera, serial=serial)

    @classmethod
    def open(cls, address: str) -> Self:
        """Open the camera of a serial number, IP, MAC or Aravis name; the only one if empty."""
        call = _library()
        call("update_device_list")
        listed = range(call("get_n_devices"))

        def text(field: str, index: int) -> str:
            return (call(f"get_device_{field}", index) or b"").decode(errors="replace")

        fields = ("serial_nbr", "address", "physical_id", "id", "model")
        connected = [
            ConnectedCamera(
                f"{text('vendor', index)} {text('model', index)}",
                tuple(filter(None, (text(field, index) for field in fields))),
            )
            for index in listed
        ]
        index = choose_camera(cls.name, address, connected)
        busy = f"{cls.name}: {connected[index]} is used by another program: close that one"
        try:
            handle = call("camera_new", text("id", index).encode())
        except CameraError as error:
            raise ValueError(f"{busy} ({error})") from None
        camera = cls(handle, camera=connected[index].model, serial=text("serial_nbr", index))
        if call("camera_is_gv_device", handle) and not call(
            "gv_device_is_controller", camera._device
        ):
            camera.close()
            raise ValueError(busy)
        return camera

    def read(self, timeout_s: float) -> Frame:
        """Wait for the frame of the last trigger."""
        if self._stream is None:
            raise ValueError("arm the camera before a frame is read")
        buffer = self._call("stream_timeout_pop_buffer", self._stream, round(timeout_s * 1e6))
        if not buffer:
            self._check_alive()
            raise self._no_frame(timeout_s)
        try:
            return self._frame_of(buffer)
        finally:
            self._call("stream_push_buffer", self._stream, buffer)

    def _frame_of(self, buffer: int) -> Frame:
        call = self._call
        block = call("buffer_get_frame_id", buffer)
        if status := call("buffer_get_status", buffer):
            raise FrameLostError(
                f"{self.camera}: incomplete frame {block}: {_STATUS.get(status, status)}"
            )
        size = c_size_t()
        data = call("buffer_get_data", buffer, byref(size))
        padding, padding_y = c_int(), c_int()
        call("buffer_get_image_padding", buffer, byref(padding), byref(padding_y))
        return self._frame(
            ctypes.string_at(data, size.value),
            shape=(
                call("buffer_get_image_height", buffer),
                call("buffer_get_image_width", buffer),
            ),
            padding=padding.value,
            block=block,
            timestamp_ns=call("buffer_get_timestamp", buffer),
        )

    def _check_alive(self) -> None:
        # the version of its bootstrap registers, which both standards have at 0
        try:
            self._call("device_read_register", self._device, 0, byref(ctypes.c_uint32()))
        except CameraError as error:
            self._gone = True
            raise CameraError(
                f"{self.camera} {self.serial} is gone: check power and cable ({error})"
            ) from None

    def _start(self) -> None:
        call = self._call
        self._stream = call("camera_create_stream", self._handle, None, None)
        payload = call("camera_get_payload", self._handle)
        for _ in range(_BUFFERS):
            call("stream_push_buffer", self._stream, call("buffer_new_allocate", payload))
        call("camera_start_acquisition", self._handle)

    def _stop(self) -> None:
        try:
            self._call("camera_stop_acquisition", self._handle)
        finally:
            self._unref_stream()

    def _drop(self) -> None:
        while buffer := self._call("stream_try_pop_buffer", self._stream):
            self._call("stream_push_buffer", self._stream, buffer)

    def _release(self) -> None:
        if self._gone:  # Aravis would wait for its answers, for several seconds
            threading.Thread(target=self._unref, daemon=True).start()
        else:
            self._unref()

    def _unref(self) -> None:
        self._unref_stream()
        if self._handle is not None:
            self._call.unref(self._handle)
            self._handle = None

    def _unref_stream(self) -> None:
        if self._stream is not None:
            self._call.unref(self._stream)
            self._stream = None


class _AravisFeatures:
    def __init__(self, call: _Library, device: int) -> None:
        self._call = call
        self._device = device

    def _kind(self, name: str) -> str:
        node = self._call("device_get_feature", self._device, name.encode())
        if not node:
            raise CameraError(f"the camera has no {name}")
        for kind, word in (("enumeration", "string"), ("boolean", "boolean"), ("float", "float")):
            if self._call.is_a(node, self._call(f"gc_{kind}_get_type")):
                return word
        return "integer"

    def available(self, name: str) -> bool:
        return bool(self._call("device_is_feature_available", self._device, name.encode()))

    def get(self, name: str) -> Value:
        kind = self._kind(name)
        value = self._call(f"device_get_{kind}_feature_value", self._device, name.encode())
        if kind == "string":
            return (value or b"").decode(errors="replace")
        return bool(value) if kind == "boolean" else value

    def set(self, name: str, value: Value) -> None:
        kind = self._kind(name)
        converted: bytes | float = value.encode() if isinstance(value, str) else value
        if kind == "integer":
            converted = int(converted)
        self._call(f"device_set_{kind}_feature_value", self._device, name.encode(), converted)

    def entries(self, name: str) -> tuple[str, ...]:
        count = c_uint()
        words = self._call(
            "device_dup_available_enumeration_feature_values_as_strings",
            self._device,
            name.encode(),
            byref(count),
        )
        texts = tuple(words[index].decode(errors="replace") for index in range(count.value))
        self._call.free(words)
        return texts

    def bounds(self, name: str) -> tuple[float, float]:
        lower, upper = c_double(), c_double()
        self._call(
            "device_get_float_feature_bounds",
            self._device,
            name.encode(),
            byref(lower),
            byref(upper),
        )
        return lower.value, upper.value

    def unit(self, name: str) -> str:
        node = self._call("device_get_feature", self._device, name.encode())
        if not self._call.is_a(node, self._call("gc_float_get_type")):
            return "raw"  # a whole number of steps
        return (self._call("gc_float_get_unit", node) or b"").decode(errors="replace")

    def execute(self, name: str) -> None:
        self._call("device_execute_command", self._device, name.encode())
