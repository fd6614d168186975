"""Which CLICK address means what on this bench. The ladder of the real PLC is written against this table.

Hosts write requests (C) and registers (DS, DF); the ladder alone drives outputs (Y). Requests are momentary: the host
sets one, sees the outcome in Y and X, and clears it. Levels are marked as such.
"""

# Requests, momentary unless marked as a level
LOCK_REQUEST = "C1"
UNLOCK_REQUEST = "C2"  # the ladder obeys only while the head sits in a dock
GRIP_REQUEST = "C3"
VENT_REQUEST = "C4"
SUPPLY_REQUEST = "C5"  # level
REQUESTS = (LOCK_REQUEST, UNLOCK_REQUEST, GRIP_REQUEST, VENT_REQUEST, SUPPLY_REQUEST)  # adjacent: read together

# Outputs, driven by the ladder. Lock and gripper valves are bistable, one coil each way: with the PLC in STOP, outputs
# off, they stay where they are. Supply valve and motor enable fall off.
LOCK_OUTPUT = "Y1"  # on = closed
GRIP_OUTPUT = "Y2"  # on = jaws closed
SUPPLY_OUTPUT = "Y3"
MOTOR_ENABLE_OUTPUT = "Y4"
UNLOCK_OUTPUT = "Y5"  # the contrary of Y1 in RUN
VENT_OUTPUT = "Y6"  # the contrary of Y2 in RUN

# Inputs X1 to X6 are read together; keep them adjacent
LOCK_CLOSED_INPUT = "X1"
LOCK_OPEN_INPUT = "X2"
TOOL_PRESENT_INPUT = "X3"
PRESSURE_OK_INPUT = "X4"
ESTOP_OK_INPUT = "X5"
HEAD_IN_DOCK_INPUT = "X6"
FIRST_INPUT, N_INPUTS = LOCK_CLOSED_INPUT, 6
SUPPLY_OK_INPUT = "X7"  # pressure switch of the air mains, before the supply valve

# Dock slots 0 to 9 have a presence sensor each, on the CPU's second slot (X021-X030)
FIRST_DOCK_INPUT, N_DOCK_SLOTS = "X21", 10

# Heartbeat: the host counts up; two seconds without a change and the ladder closes the supply, stops the motors, and
# holds lock and grip. DS1 to DS5 are read together; keep them adjacent
HEARTBEAT_REGISTER, N_HEARTBEAT = "DS1", 5
HEARTBEAT_ECHO_REGISTER = "DS2"
SCAN_COUNTER_REGISTER = "DS3"  # counts scans from 0 to 29999 and over again
FAULT_REGISTER = "DS4"
# Session: written by the host at connect, never 0. On its first scan (SC2) the ladder clears it, the scan counter and
# all requests, and takes Y1 and Y2 over from the sensors X1 and X4: so a restart shows, and moves no valve
SESSION_REGISTER = "DS5"
HOST_TIME_OUT_S = 2.0

# Job label, shown on the panel: which object is gripped, for which time
JOB_OBJECT_REGISTER = "DS10"
JOB_REPEAT_REGISTER = "DS11"

# Analogue values
PRESSURE_REGISTER = "DF1"  # psi, measured
SUPPLY_SETPOINT_REGISTER = "DF2"  # psi
# Stroke recipe of the gripper, five floats in this order: open gap, closed gap, close speed, lift speed, longest lift
FIRST_RECIPE_REGISTER, N_RECIPE = "DF3", 5
