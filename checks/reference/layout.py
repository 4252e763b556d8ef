# SPDX-License-Identifier: Apache-2.0
"""Where each number of the plant lies in the arrays handed to the compiled functions.

`drive[i, COLUMN]` holds what belongs to drive i, `shared[COLUMN]` what belongs to the machine.
Zero is the neutral value of every effect's amplitude; widths and speeds beside an amplitude of
zero are never read.
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
    SIGN_FORM,  # 0 tanh, 1 arctan
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
    INTEGRATOR_LEAK,  # 1/s
    MAGNETIC_TORQUE,  # N m
    MAGNETIC_WIDTH,  # N m
    # Friction effects.
    ASYMMETRY,  # 1
    ASYMMETRY_WIDTH,  # m/s, 0: the catalogue's form
    STRIBECK_TORQUE,  # N m
    STRIBECK_SPEED,  # m/s
    STRIBECK_FORM,  # 0 Gaussian, 1 Lorentzian
    LOAD_FRICTION,  # 1
    LOAD_FRICTION_FORM,  # 0 by gear force, 1 by the mean of motor torque and gear torque
    PRESLIDE_LENGTH,  # m
    PRESLIDE_FORM,  # 0 Dahl, 1 LuGre, 2 three parallel elements
    DRAG,  # N m s^2/m^2
    DRAG_EXPONENT,  # 1
    EXTRA_COULOMB,  # N m
    EXTRA_COULOMB_FORM,  # 0 tanh, 1 arctan
    EXTRA_VISCOUS,  # N m s/m
    EXTRA_VISCOUS_EXPONENT,  # 1
    DEGRESSIVE_TORQUE,  # N m
    DEGRESSIVE_SPEED,  # m/s
    DEGRESSIVE_FORM,  # 0 levels off, 1 rises with the logarithm of the speed
    PLACE_SLOPE,  # 1/m, Coulomb friction along the rail
    PLACE_MIDDLE,  # m
    PLACE_FORM,  # 0 linear, 1 levelling off
    DRIFT_RATE,  # 1/s, linear in time
    DRIFT_SHARE,  # 1, loss at the rated dissipated power
    DRIFT_TIME,  # s
    DRIFT_POWER,  # W
    BUMP_TORQUE,  # N m
    BUMP_PLACE,  # m
    BUMP_WIDTH,  # m
    LAG_TORQUE,  # N m, frictional lag
    LAG_SPEED,  # m/s
    LAG_TIME,  # s
    BRAKE_TORQUE,  # N m
    BRAKE_FROM,  # s
    BRAKE_UNTIL,  # s
    DWELL_TORQUE,  # N m
    DWELL_TIME,  # s
    DWELL_SPEED,  # m/s
    # Torque between controller and rotor.
    CURRENT_LAG,  # s
    CURRENT_LAG_FORM,  # 0 one lag, 1 two lags of half the time
    ACTUATOR_GAIN,  # 1, less one
    RIPPLE_TORQUE,  # N m
    RIPPLE_ORDER,  # periods per motor turn
    RIPPLE_PHASE,  # rad
    RIPPLE_SECOND,  # share of the second harmonic
    RIPPLE_THIRD,  # share of the third harmonic
    RIPPLE_CURRENT,  # 1, ripple proportional to the torque
    SPEED_INERTIA,  # s^2/m^2
    # Transmission.
    BACKLASH,  # m, full width
    BACKLASH_FORM,  # 0 linear contact, 1 soft contact with unequal damping
    STIFFNESS_SLOPE,  # 1/m
    STIFFNESS_PLACE,  # m
    STIFFNESS_FORM,  # 0 stiffness linear in the place, 1 compliance linear
    HARDENING,  # 1/m^2
    ECCENTRICITY,  # m
    ECCENTRICITY_PHASE,  # rad
    ECCENTRICITY_SECOND,  # share of the second harmonic
    SLIP_FORCE,  # N, 0: no slip
    SLIP_SPEED,  # m/s
    LOAD_SHARE,  # 1, of a rigid drive's mass, behind a spring; 0: none
    LOAD_RATE,  # rad/s, of motor and load against each other
    LOAD_DAMPING,  # 1
    LOAD_HARDENING,  # 1/m^2
    # Forces on the carriage.
    CONSTANT_FORCE,  # N, a load against the positive direction
    CONSTANT_SLOPE,  # N/m
    CABLE_STIFFNESS,  # N/m
    CABLE_PLACE,  # m
    CABLE_CUBIC,  # 1/m^2
    CABLE_HYSTERESIS,  # N
    CABLE_LENGTH,  # m
    BUMPER_STIFFNESS,  # N/m^2
    BUMPER_PLACE,  # m
    # A servo, whose controller asks for a share of its supply.
    DRIVE_GAIN,  # N m, torque at the full supply, standing
    BACK_EMF,  # N m s/rad, by which it falls
    LOAD_MOMENT,  # N m, of the arm held level
    LOAD_ANGLE,  # rad, where the arm hangs
    PRESS_MOTOR,  # 1, friction by the motor's torque
    PRESS_LOAD,  # 1, by the load's
    PRESS_SPEED,  # rad/s, at which that has fallen off; 0: never
    PRESS_FORM,  # 0 Gaussian, 1 Lorentzian
    SQUARE_MOTOR,  # 1/(N m), friction by the square of the motor's torque
    SQUARE_LOAD,  # 1/(N m), by that of the load's
    SQUARE_SPEED,  # rad/s
    SQUARE_FORM,  # 0 Gaussian, 1 Lorentzian
    # An arm on a shaft at RAIL_X, RAIL_Y, whose angle takes the place of a carriage's height.
    ARM_X,  # m, from the shaft outwards
    ARM_Y,  # m
    ARM_RISE,  # m, its length, negative where positive angles lower it
    ARM_MOMENT,  # kg m, its first moment, of the same sign
    ARM_ZERO,  # rad, where it lies level
    DRIVE_COLUMNS,
) = range(116)

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
    BRISTLE_A,
    BRISTLE_B,
    BRISTLE_C,
    CURRENT_A,  # N m
    CURRENT_B,  # N m
    HEAT,  # 1
    CABLE_STATE,  # 1
    SLIP,  # m
    LAGGED_SPEED,  # m/s
    REST,  # 1
    INTERNALS,
) = range(11)
