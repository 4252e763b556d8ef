# SPDX-License-Identifier: Apache-2.0
"""Where each number of the plant lies in the arrays handed to the compiled functions.

`drive[i, COLUMN]` holds what belongs to drive i, `shared[COLUMN]` what belongs to the machine.
Zero is the neutral value of every effect's amplitude; widths and speeds beside an amplitude of
zero are never read.

Arguments that many functions here and in `blind.forms` have:

    time, cycle: since the start, and of the controllers [s]
    i, d: number of a drive, and its row of `drive`
    place, speed: of the motor at the rail [m, m/s]; in `dynamics` place is the coordinate S_i
    rail_place, rail_speed: of the carriage relative to the frame [m, m/s]
    load: force of the gear [N]
    held, delivered: torque of the controller in this cycle [N m], share that the supply delivers
    own or internals, rates: (INTERNALS,) states of a drive, empty where no effect needs one, and
        what is written: their rates
    x, dx: (n,) state, see `dynamics`, and what is written: its derivative
    matrix, side, slopes: (2D + 4, 2D + 4), (2D + 4,), (STAGES + 1, n) work space
    position, velocity: (D, K) set-points at every cycle [m or rad] and their derivatives
    rtol, atol: tolerances of an integration step, the absolute one in the unit of each state
    effects: what the machine has beside the nominal physics
"""

# Per drive: nominal physics.
(
    GEAR,  # rad/m, motor angle per rail travel
    MOTOR_MASS,  # kg, drive inertia referred to the rail
    CARRIAGE_MASS,  # kg
    STIFFNESS,  # N/m
    DAMPING,  # N s/m
    COULOMB,  # N m
    VISCOUS,  # N m s/m
    SIGN_WIDTH,  # m/s, regularisation of the sign
    RAIL_X,  # m, rail foot
    RAIL_Y,  # m
    ROD_LENGTH,  # m
    # Controller as it really is.
    LAW,  # 0 PI on velocity with feedforward, 1 P on velocity from the encoder, 2 PD on position
    POSITION_GAIN,  # 1/s
    VELOCITY_GAIN,  # N m s/m
    INTEGRAL_GAIN,  # N m/m
    FEEDFORWARD,  # 1
    TORQUE_LIMIT,  # N m
    TORQUE_KNEE,  # 0 hard clip, else exponent of a soft one
    TORQUE_FADE,  # s/m, share of the limit lost per speed
    TORQUE_SKEW,  # 1, share by which the limit is larger forwards and smaller backwards
    ENCODER_STEP,  # m
    ENCODER_PHASE,  # steps, where within a step the reading jumps, less one half
    ENCODER_VELOCITY,  # s, lag of the coarse position's error in the speed; 0: true speed
    # Friction effects.
    ASYMMETRY,  # 1
    STRIBECK_TORQUE,  # N m
    STRIBECK_SPEED,  # m/s
    LOAD_FRICTION,  # 1
    PRESLIDE_LENGTH,  # m
    PRESLIDE_DAMPING,  # s
    DRAG,  # N m s^2/m^2
    EXTRA_COULOMB,  # N m
    EXTRA_VISCOUS,  # N m s/m
    DEGRESSIVE_TORQUE,  # N m
    DEGRESSIVE_SPEED,  # m/s
    PLACE_SLOPE,  # 1/m, Coulomb friction along the rail
    PLACE_MIDDLE,  # m
    DRIFT_RATE,  # 1/s, linear in time
    # Torque between controller and rotor.
    CURRENT_LAG,  # s
    ACTUATOR_GAIN,  # 1, less one
    RIPPLE_TORQUE,  # N m
    RIPPLE_ORDER,  # periods per motor turn
    RIPPLE_PHASE,  # rad
    # Transmission.
    BACKLASH,  # m, full width
    STIFFNESS_SLOPE,  # 1/m
    STIFFNESS_PLACE,  # m
    ECCENTRICITY,  # m
    ECCENTRICITY_PHASE,  # rad
    LOAD_SHARE,  # 1, of a rigid drive's mass, behind a spring; 0: none
    LOAD_RATE,  # rad/s, of motor and load against each other
    LOAD_DAMPING,  # 1
    LOAD_HARDENING,  # 1/m^2
    # Forces on the carriage.
    CONSTANT_FORCE,  # N, a load against the positive direction
    CABLE_STIFFNESS,  # N/m
    CABLE_PLACE,  # m
    STOP_STIFFNESS,  # N/m, of both end stops
    STOP_LOWER,  # m
    STOP_UPPER,  # m
    # A servo, whose controller asks for a share of its supply.
    DRIVE_GAIN,  # N m, torque at the full supply, standing
    BACK_EMF,  # N m s/rad, by which it falls
    LOAD_MOMENT,  # N m, of the arm held level
    LOAD_ANGLE,  # rad, where the arm hangs
    PRESS_MOTOR,  # 1, friction by the motor's torque
    PRESS_LOAD,  # 1, by the load's
    PRESS_SPEED,  # rad/s, at which that has fallen off; 0: never
    SQUARE_MOTOR,  # 1/(N m), friction by the square of the motor's torque
    SQUARE_LOAD,  # 1/(N m), by that of the load's
    SQUARE_SPEED,  # rad/s
    # An arm on a shaft at RAIL_X, RAIL_Y, whose angle takes the place of a carriage's height.
    ARM_X,  # m, from the shaft outwards
    ARM_Y,  # m
    ARM_RISE,  # m, its length, negative where positive angles lower it
    ARM_MOMENT,  # kg m, its first moment, of the same sign
    ARM_ZERO,  # rad, where it lies level
    DRIVE_COLUMNS,
) = range(73)

# Shared by the machine.
(
    GRAVITY,  # m/s^2
    PLATFORM,  # 1 with rods and platform, 0 without
    RIGID,  # 1: motor and carriage are one mass
    CYCLE,  # s
    TOOL_MASS,  # kg
    ROD_MASS,  # kg
    ROD_AT_CARRIAGE,  # integral of (1-u)^2 over the rod, 1/3 where uniform
    ROD_BETWEEN,  # integral of u(1-u), 1/6 where uniform
    ROD_AT_PLATFORM,  # integral of u^2, 1/3 where uniform
    ROD_CENTRE,  # integral of u, 1/2 where uniform
    PAYLOAD,  # kg
    PAYLOAD_RAMP,  # s
    FRAME_MASS,  # kg, 0: the frame stands still
    FRAME_STIFFNESS,  # N/m
    FRAME_DAMPING,  # N s/m
    FRAME_QUADRATIC,  # N s^2/m^2
    FRAME_SOFTENING,  # 1, share of the stiffness lost far from rest
    FRAME_GIVE,  # m, where half of that is lost
    FRAME_PRELOAD,  # N, what the drives rest on the frame at the start
    SAG,  # 1/W, supply sag
    RELEASE,  # s, from when on servos are switched off; 0: never
    ROTARY,  # 1: arms on shafts carry the rods, not carriages
    PAYLOAD_FROM,  # s, behind it PAYLOAD_UNTIL [s], and so on for each time it is taken up
) = range(23)
PAYLOAD_UNTIL = PAYLOAD_FROM + 1
PAYLOAD_TURNS = 6
SHARED_COLUMNS = PAYLOAD_FROM + 2 * PAYLOAD_TURNS

# Internal states of one drive, behind positions and velocities.
(
    BRISTLE,
    CURRENT,  # N m
    INTERNALS,
) = range(3)
