-- SPDX-License-Identifier: Apache-2.0
-- Wireshark dissector of the wire format between bridge and positioners (docs/wire-format.md).
--
-- Opens buses.pcap of a capture (link type 209): copy this file into the folder "Personal Lua
-- Plugins" of Help > About Wireshark > Folders, or
--   wireshark -X lua_script:tools/fiber_positioners.lua buses.pcap
-- Shows `bus/address` and the decoded message. Checksums are shown and not verified; the kind of a
-- reply follows from its length.

local fiber = Proto("fiber", "Fibre positioners over I2C")

local OPCODES = {
  [1] = "LOAD", [2] = "GO", [3] = "STOP", [4] = "CLEAR", [5] = "RESET",
  [6] = "CONFIG", [7] = "IDENTIFY", [8] = "HEARTBEAT", [9] = "ADDRESS", [10] = "PLACE",
  [11] = "MOVES",
}
local STATES = {
  [1] = "UNCONFIGURED", [2] = "IDLE", [3] = "LOADED", [4] = "MOVING",
  [5] = "DONE", [6] = "STOPPED", [7] = "FAULT",
}
local FAULTS = {
  [0] = "NONE", [1] = "BAD_LENGTH", [2] = "BAD_OPCODE", [3] = "BAD_CRC", [4] = "BAD_DURATION",
  [5] = "BAD_VELOCITY", [6] = "BAD_PADDING", [7] = "BAD_VERSION", [8] = "BAD_VALUE",
  [16] = "NOT_CONFIGURED", [17] = "WRONG_STATE", [18] = "STALE_SEQUENCE", [19] = "OVER_SPEED",
  [20] = "OUTSIDE_LIMITS", [21] = "OTHER_QUANTUM", [22] = "OTHER_GEARS", [23] = "UNLISTED_SPEED",
  [24] = "SHORT_MOVE", [32] = "WATCHDOG", [33] = "MEMORY", [34] = "STALL", [35] = "SILENCE",
}

local f = {
  bus = ProtoField.uint8("fiber.bus", "Bus"),
  address = ProtoField.uint16("fiber.address", "Address"),
  ten_bit = ProtoField.bool("fiber.ten_bit", "Ten-bit address"),
  read = ProtoField.bool("fiber.read", "Read"),
  opcode = ProtoField.uint8("fiber.opcode", "Opcode", base.DEC, OPCODES, 0xF0),
  sequence = ProtoField.uint8("fiber.sequence", "Sequence", base.DEC, nil, 0x0F),
  theta = ProtoField.uint8("fiber.theta_segments", "Theta segments", base.DEC, nil, 0xF0),
  phi = ProtoField.uint8("fiber.phi_segments", "Phi segments", base.DEC, nil, 0x0F),
  segments = ProtoField.bytes("fiber.segments", "Segments"),
  countdown = ProtoField.uint16("fiber.countdown", "Countdown (10 us)"),
  version = ProtoField.uint8("fiber.version", "Version", base.DEC, nil, 0x0F),
  velocity_bits = ProtoField.uint8("fiber.velocity_bits", "Velocity bits"),
  duration_bits = ProtoField.uint8("fiber.duration_bits", "Duration bits"),
  tick = ProtoField.uint32("fiber.tick_us", "Tick (us)"),
  quantum = ProtoField.uint32("fiber.quantum_prad", "Quantum (1e-12 rad)"),
  theta_low = ProtoField.int32("fiber.theta_low", "Theta low (quanta)"),
  theta_high = ProtoField.int32("fiber.theta_high", "Theta high (quanta)"),
  phi_low = ProtoField.int32("fiber.phi_low", "Phi low (quanta)"),
  phi_high = ProtoField.int32("fiber.phi_high", "Phi high (quanta)"),
  theta_speed = ProtoField.uint16("fiber.theta_speed", "Theta speed (units)"),
  phi_speed = ProtoField.uint16("fiber.phi_speed", "Phi speed (units)"),
  watchdog = ProtoField.uint16("fiber.watchdog_ms", "Watchdog (ms)"),
  silence = ProtoField.uint16("fiber.silence_ms", "Silence (ms)"),
  slot = ProtoField.uint16("fiber.slot", "Slot in the roll call"),
  block = ProtoField.uint8("fiber.block", "Block", base.DEC, { [1] = "GEARS", [2] = "SPEEDS", [3] = "RAMPS" }),
  coupling = ProtoField.bytes("fiber.coupling", "Coupling (2^-22), motor by joint"),
  motor_limits = ProtoField.bytes("fiber.motor_limits", "Motor limits (quanta)"),
  motor_speed = ProtoField.bytes("fiber.motor_speed", "Motor speeds (2^-8 units)"),
  speeds = ProtoField.bytes("fiber.speeds", "List of speeds"),
  ramps = ProtoField.bytes("fiber.ramps", "Ramps (us)"),
  present = ProtoField.bytes("fiber.present", "Roll call, 0 = present"),
  serial = ProtoField.uint32("fiber.serial", "Serial number"),
  new_address = ProtoField.uint16("fiber.new_address", "New address", base.DEC, nil, 0x7FFF),
  state = ProtoField.uint8("fiber.state", "State", base.DEC, STATES, 0xF0),
  order_crc = ProtoField.uint16("fiber.order_crc", "CRC of order, working values and counters", base.HEX),
  boot = ProtoField.uint8("fiber.boot", "Boot counter"),
  fault = ProtoField.uint8("fiber.fault", "Fault", base.DEC, FAULTS),
  alerts = ProtoField.uint8("fiber.alerts", "Alerts", base.HEX),
  theta_position = ProtoField.int32("fiber.theta", "Theta (quanta)"),
  phi_position = ProtoField.int32("fiber.phi", "Phi (quanta)"),
  crc = ProtoField.uint16("fiber.crc", "CRC-16", base.HEX),
  pec = ProtoField.uint8("fiber.pec", "PEC", base.HEX),
}
local list = {}
for _, field in pairs(f) do list[#list + 1] = field end
fiber.fields = list

-- adds fields one after the other: { field, size }, size 0 for a field that shares the next one's byte
local function fill(tree, data, at, layout)
  for _, item in ipairs(layout) do
    tree:add(item[1], data(at, math.max(item[2], 1)))
    at = at + item[2]
  end
  return at
end

local COMMANDS = {
  [2] = { { f.opcode, 0 }, { f.sequence, 1 }, { f.countdown, 2 }, { f.crc, 2 } },
  [6] = {
    { f.opcode, 0 }, { f.version, 1 }, { f.velocity_bits, 1 }, { f.duration_bits, 1 },
    { f.tick, 4 }, { f.quantum, 4 }, { f.theta_low, 4 }, { f.theta_high, 4 }, { f.phi_low, 4 },
    { f.phi_high, 4 }, { f.theta_speed, 2 }, { f.phi_speed, 2 }, { f.watchdog, 2 },
    { f.silence, 2 }, { f.slot, 2 },
  },
  [9] = { { f.opcode, 1 }, { f.serial, 4 }, { f.new_address, 2 }, { f.crc, 2 } },
  [10] = { { f.opcode, 1 }, { f.theta_position, 4 }, { f.phi_position, 4 }, { f.crc, 2 } },
}
local BLOCKS = {
  [1] = { { f.coupling, 16 }, { f.motor_limits, 16 }, { f.motor_speed, 8 } },
}
local SHORT = { { f.opcode, 1 }, { f.pec, 1 } }
local VERIFY = { { f.state, 0 }, { f.sequence, 1 }, { f.order_crc, 2 }, { f.boot, 1 }, { f.pec, 1 } }
local STATUS = {
  { f.fault, 1 }, { f.alerts, 1 }, { f.theta_position, 4 }, { f.phi_position, 4 }, { f.crc, 2 },
}
local IDENTITY = {
  { f.opcode, 0 }, { f.version, 1 }, { f.serial, 4 }, { f.new_address, 2 }, { f.boot, 1 },
  { f.pec, 1 },
}

local function size_of(layout)
  local size = 0
  for _, item in ipairs(layout) do size = size + item[2] end
  return size
end

-- adds the blocks of a CONFIG; returns where they end
local function blocks(tree, data, at)
  while data:len() - at >= 4 do
    local layout = BLOCKS[data(at, 1):uint()]
    local size = data(at + 1, 1):uint()
    tree:add(f.block, data(at, 1))
    local bytes = ({ [2] = f.speeds, [3] = f.ramps })[data(at, 1):uint()]
    if bytes and data:len() - at >= size + 4 then
      tree:add(bytes, data(at + 2, size))
    elseif layout and size == size_of(layout) and data:len() - at >= size + 4 then
      fill(tree, data, at + 2, layout)
    end
    at = at + 2 + size
  end
  return at
end

local function command(tree, data, at)
  local left = data:len() - at
  if left < 2 then return "frame cut short" end
  local opcode = data(at, 1):bitfield(0, 4)
  local name = OPCODES[opcode] or "unknown"
  if (opcode == 1 or opcode == 11) and left >= 4 then
    local both = data(at + 1, 1)
    at = fill(tree, data, at, { { f.opcode, 0 }, { f.sequence, 1 }, { f.theta, 0 }, { f.phi, 1 } })
    if left > 4 then tree:add(f.segments, data(at, left - 4)) end
    tree:add(f.crc, data(data:len() - 2, 2))
    local what = opcode == 1 and "segments" or "moves"
    return string.format("%s, %d + %d %s", name, both:bitfield(0, 4), both:bitfield(4, 4), what)
  end
  if opcode == 6 and left >= size_of(COMMANDS[6]) + 2 then
    at = blocks(tree, data, fill(tree, data, at, COMMANDS[6]))
    if data:len() - at == 2 then tree:add(f.crc, data(at, 2)) end
    return name
  end
  local layout = COMMANDS[opcode] or SHORT
  if left == size_of(layout) then fill(tree, data, at, layout) end
  return name
end

local function reply(tree, data, at)
  local left = data:len() - at
  if left == size_of(IDENTITY) then
    fill(tree, data, at, IDENTITY)
    return "identity"
  elseif left ~= 5 and left ~= 17 then
    return left == 0 and "not acknowledged" or "reply cut short"
  end
  local state = STATES[data(at, 1):bitfield(0, 4)] or "unknown state"
  at = fill(tree, data, at, VERIFY)
  if left == 17 then fill(tree, data, at, STATUS) end
  return (left == 17 and "status " or "verify ") .. state
end

-- Wireshark removes bus and flags from the data; its own dissector makes them fields.
local i2c = DissectorTable.get("wtap_encap"):get_dissector(wtap.I2C_LINUX)
local i2c_bus = Field.new("i2c.bus")

-- A read carries only the two high bits of a ten-bit address; the write before it carries all bits.
local written, known = {}, {}

function fiber.dissector(data, packet, root)
  i2c:call(data, packet, root)
  if data:len() < 1 then return end
  packet.cols.protocol = "FIBER"
  local tree = root:add(fiber, data())
  local bus = i2c_bus()
  local where = bus and bus.value or 0
  tree:add(f.bus, where)
  local head, at = data(0, 1):uint(), 1
  local read = head % 2 == 1
  local ten_bit = head >= 0xF0 and head < 0xF8
  local address = math.floor(head / 2)
  if ten_bit then
    -- the first byte of a read carries only the two high bits
    address = data(0, 1):bitfield(5, 2) * 256
    if not read and data:len() > 1 then
      address = address + data(1, 1):uint()
      at = 2
      written[where] = address
    elseif not packet.visited then
      known[packet.number] = written[where]
    end
    address = known[packet.number] or address
  end
  tree:add(f.address, data(0, at), address)
  tree:add(f.ten_bit, data(0, 1), ten_bit)
  tree:add(f.read, data(0, 1), read)
  local robot = string.format("%d/%d", where, address)
  packet.cols.src = read and robot or "bridge"
  packet.cols.dst = read and "bridge" or robot
  local called = head == 0 and data:len() > at and data(at, 1):uint() == 0xF1
  if called then at = at + 1 end
  local words
  if read and ten_bit and address == 1023 then
    if data:len() > at then tree:add(f.present, data(at)) end
    words = "roll call"
  elseif read then
    words = reply(tree, data, at)
  elseif data:len() == at then
    words = "address only"
  else
    words = command(tree, data, at)
  end
  packet.cols.info = called and (words .. " to all") or words
end

DissectorTable.get("wtap_encap"):add(wtap.I2C_LINUX, fiber)
