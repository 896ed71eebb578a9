"""CXP1's text framing for consoles: a colon, upper-case hexadecimal digits, a newline, and a CRC
that guards them.
"""

_DIGITS = b"0123456789ABCDEF"


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, initial value 0xFFFF, not reflected."""
    crc = 0xFFFF
    for byte in data:
        # Eight steps of the shift register at once: what the top byte feeds back, and what that
        # feeds back again.
        mixed = crc >> 8 ^ byte
        mixed ^= mixed >> 4
        crc = (crc << 8 ^ mixed << 12 ^ mixed << 5 ^ mixed) & 0xFFFF
    return crc


def to_text(body: bytes) -> bytes:
    """Make a whole frame, CRC and newline included."""
    crc = crc16(body)
    frame = body + bytes((crc & 0xFF, crc >> 8))
    text = bytearray(2 * len(frame) + 2)
    text[0] = 58  # colon
    for k, byte in enumerate(frame):
        text[2 * k + 1] = _DIGITS[byte >> 4]
        text[2 * k + 2] = _DIGITS[byte & 15]
    text[-1] = 10
    return bytes(text)


def from_text(line: bytes) -> bytes:
    """Return body and CRC of a line without its newline; nothing if it is no frame, or broken."""
    # A half line of noise may stand in front.
    digits = line[line.rfind(b":") + 1 :] if b":" in line else b""
    if len(digits) < 8 or len(digits) % 2:
        return b""
    frame = bytearray()
    for k in range(0, len(digits), 2):
        high = _DIGITS.find(digits[k : k + 1])
        low = _DIGITS.find(digits[k + 1 : k + 2])
        if high < 0 or low < 0:
            return b""
        frame.append(16 * high + low)
    return bytes(frame) if crc16(bytes(frame[:-2])) == frame[-2] | frame[-1] << 8 else b""
