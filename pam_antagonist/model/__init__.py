"""The physics of the joint, muscles, chambers and valves: numpy and numba only, one file a domain.

In compiled functions `p` is a parameter vector (P,), `x` a state (n,) and `u` an input: the valve voltages [V] over the
step, and where it is known the torque from outside [N m], (2,) or (3,). `i`, `muscle` and `valve` are 0 or 1. Other
names stand for the same quantity everywhere, in SI units: `angle` ψ and `velocity` ψ̇ of the joint, `sine` and `cosine`
the travel of a muscle's end and its lever arm over r (sin ψ and cos ψ of a lever), `muscle_length` l_i, `pressure` P_i
(absolute), `force_1` and `force_2`, `alpha` the open rate α of a valve, `overlap` its c, `supply` P_tank, `flow` m_i,
`chamber_volume` V_i and `volume_rate` its derivative, `coulomb` T_s + T_p, `viscous` c_s, `applied` all torques but
friction, `dt` the length of a step.
"""
