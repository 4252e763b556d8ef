# SPDX-License-Identifier: Apache-2.0
"""Where the forms keep their numbers and states: behind the reference's own, see its `layout`."""

from checks.reference import layout as at

# Per drive. Zero is the neutral value of every size.
(
    # Stribeck: torque exp(-|v / speed|^exponent), or torque / (1 + |v| / speed).
    STRIBECK_TORQUE,  # N m
    STRIBECK_SPEED,  # m/s
    STRIBECK_EXPONENT,  # 1; 0: the rational form
    LOAD_SHARE_TORQUE,  # 1
    LOAD_EXPONENT,  # 1
    ASYMMETRY,  # 1
    ASYMMETRY_WIDTH,  # m/s
    ASYMMETRY_EXPONENT,  # 1
    BRISTLE_KIND,  # 0 none, 1 Dahl with an exponent, 2 elasto-plastic, 3 slip elements, 4 LuGre
    BRISTLE_LENGTH,  # m
    BRISTLE_SHAPE,  # 1: Dahl's exponent, break-away share, spread of the elements, or none
    BRISTLE_TIME,  # s, micro-damping over micro-stiffness
    DRAG,  # N m (s/m)^exponent
    DRAG_EXPONENT,  # 1
    THINNING_TORQUE,  # N m
    THINNING_SPEED,  # m/s
    THINNING_EXPONENT,  # 1; 0: the rational form
    WARMING_SHARE,  # 1
    WARMING_FAST,  # s
    WARMING_SLOW,  # s
    WARMING_SPLIT,  # 1, part of the fast time
    OIL_SHARE,  # 1 per unit of warmth
    OIL_TIME,  # s
    OIL_POWER,  # W
    PLACE_SHARE,  # 1
    PLACE_LENGTH,  # m, wavelength
    PLACE_PHASE,  # rad
    DRY_EXTRA,  # N m
    DRY_EXTRA_WIDTH,  # m/s
    VISCOUS_EXTRA,  # N m (s/m)^exponent
    VISCOUS_EXPONENT,  # 1
    # Torque between controller and rotor.
    COGGING,  # N m
    COGGING_ORDER,  # 1
    COGGING_PHASE,  # rad
    COGGING_SECOND,  # 1
    COGGING_SECOND_PHASE,  # rad
    COGGING_THIRD,  # 1
    COGGING_THIRD_PHASE,  # rad
    CURRENT_RATE,  # rad/s
    CURRENT_DAMPING,  # 1
    FLUX_SHARE,  # 1, torque missing at small currents
    FLUX_SATURATION,  # 1/(N m), further share missing per torque
    # Transmission.
    ERROR_LENGTH,  # m
    ERROR_PHASE,  # rad
    ERROR_SECOND,  # 1
    ERROR_SECOND_PHASE,  # rad
    ERROR_THIRD,  # 1
    ERROR_THIRD_PHASE,  # rad
    GAP,  # m, full width
    GAP_KIND,  # 1 contact that damps with its depth, 2 flanks rounded off
    GAP_SHAPE,  # s/m, or the rounding as a share of the gap
    SPAN_SLOPE,  # 1/m
    SPAN_PLACE,  # m
    SPAN_LOWER,  # m
    SPAN_UPPER,  # m
    # Forces on the carriage.
    HOSE_STIFFNESS,  # N/m
    HOSE_PLACE,  # m
    HOSE_LENGTH,  # m
    GAS_FORCE,  # N
    GAS_PLACE,  # m
    GAS_LENGTH,  # m
    GAS_EXPONENT,  # 1
    # Outside the catalogue.
    MEMORY_TORQUE,  # N m
    MEMORY_SPEED,  # m/s
    MEMORY_TIME,  # s
    REST_TORQUE,  # N m
    REST_TIME,  # s
    REST_WAY,  # m
    BALL_SHARE,  # 1
    BALL_PITCH,  # m
    BALL_PHASE,  # rad
    STOP_STIFFNESS,  # N/m^1.5
    STOP_PLACE,  # m
    STOP_DAMPING,  # s/m
    HUNG_MASS,  # kg
    HUNG_RATE,  # rad/s
    HUNG_DAMPING,  # 1
    MESH_SHARE,  # 1
    MESH_PITCH,  # m
    MESH_PHASE,  # rad
    COPPER_SHARE,  # 1
    COPPER_TIME,  # s
    COPPER_TORQUE,  # N m
    SHAKE_FORCE,  # N
    SHAKE_RATE,  # rad/s
    SHAKE_PHASE,  # rad
    END,
) = range(at.DRIVE_COLUMNS, at.DRIVE_COLUMNS + 87)
COLUMNS = END - at.DRIVE_COLUMNS

# States of a drive, behind the reference's.
(
    BRISTLE_1,
    BRISTLE_2,
    BRISTLE_3,
    BRISTLE_4,
    CURRENT,  # N m
    CURRENT_SPEED,  # N m/s
    OIL,  # 1
    REMEMBERED_1,  # m/s
    REMEMBERED_2,  # m/s
    BOND,  # s, how long the contact has rested
    HUNG,  # m, appendage less carriage
    HUNG_SPEED,  # m/s
    COPPER,  # 1
    STATES,
) = range(at.INTERNALS, at.INTERNALS + 14)
