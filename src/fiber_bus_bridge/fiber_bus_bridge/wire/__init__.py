"""The bytes on the bus: pure functions between tables and frames."""

from fiber_bus_bridge.wire.codes import (
    CALL_PREFIX,
    MAX_SEGMENTS,
    VERSION,
    Alert,
    Fault,
    Opcode,
    RobotState,
)
from fiber_bus_bridge.wire.commands import (
    CONFIG_BYTES,
    CONFIG_FIELDS,
    Configuration,
    decode_command,
    decode_config,
    encode_command,
    encode_config,
)
from fiber_bus_bridge.wire.frames import Addresses, Frames, general_call
from fiber_bus_bridge.wire.orders import Orders, decode_load, encode_load
from fiber_bus_bridge.wire.replies import (
    IDENTITY_BYTES,
    IDENTITY_FIELDS,
    STATUS_BYTES,
    STATUS_FIELDS,
    VERIFY_BYTES,
    Identities,
    Statuses,
    decode_identity,
    decode_status,
    encode_identity,
    encode_status,
)

__all__ = [
    "CALL_PREFIX",
    "CONFIG_BYTES",
    "CONFIG_FIELDS",
    "IDENTITY_BYTES",
    "IDENTITY_FIELDS",
    "MAX_SEGMENTS",
    "STATUS_BYTES",
    "STATUS_FIELDS",
    "VERIFY_BYTES",
    "VERSION",
    "Addresses",
    "Alert",
    "Configuration",
    "Fault",
    "Frames",
    "Identities",
    "Opcode",
    "Orders",
    "RobotState",
    "Statuses",
    "decode_command",
    "decode_config",
    "decode_identity",
    "decode_load",
    "decode_status",
    "encode_command",
    "encode_config",
    "encode_identity",
    "encode_load",
    "encode_status",
    "general_call",
]
