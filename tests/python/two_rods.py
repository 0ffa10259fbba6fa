"""The two-link arm of Cristofaro and De Luca, in closed form and as a robot; gravity is compensated, so it has none."""

import numpy as np

from linkside import Robot

A, B, C = 38.0 + 1 / 3, 15.0, 15.0
FRICTION = np.diag([0.1, 0.3])
START = np.array([-2 * np.pi / 3, np.pi / 10, -0.5, 1.0])

ROD = """<link name="{name}"><inertial><origin xyz="{half} 0 0"/><mass value="{mass}"/>
  <inertia ixx="1e-9" ixy="0" ixz="0" iyy="{inertia}" iyz="0" izz="{inertia}"/></inertial></link>"""
URDF = f"""<robot name="rods"><link name="base"/>
  {ROD.format(name="one", half=0.5, mass=10, inertia=10 / 12)}{ROD.format(name="two", half=0.75, mass=20, inertia=3.75)}
  <joint name="j1" type="continuous"><parent link="base"/><child link="one"/><axis xyz="0 0 1"/></joint>
  <joint name="j2" type="continuous"><parent link="one"/><child link="two"/>
    <origin xyz="1 0 0"/><axis xyz="0 0 1"/></joint>
</robot>"""


def robot():
    joints = [
        {"name": name, "elastic": False, "link_friction": [0, 0, 0, 0, 0, viscous]}
        for name, viscous in (("j1", 0.1), ("j2", 0.3))
    ]
    return Robot.from_urdf(URDF, joints, gravity=[0, 0, 0])


def mass(q):
    c = np.cos(q[1])
    return np.array([[A + 2 * B * c, C + B * c], [C + B * c, C]])


def coriolis(q, v):
    h = -B * np.sin(q[1])
    return np.array([[h * v[1], h * (v[0] + v[1])], [-h * v[0], 0.0]])


def forward(q, v, tau):
    return np.linalg.solve(mass(q), tau - coriolis(q, v) @ v - FRICTION @ v)


def rk4(slope, t, x, step):
    k1 = slope(t, x)
    k2 = slope(t + step / 2, x + step / 2 * k1)
    k3 = slope(t + step / 2, x + step / 2 * k2)
    k4 = slope(t + step, x + step * k3)
    return x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def nicosia_tomei(gain, spring, tau):
    """Plant and the observer as printed, x = (q, v, x̂₁, x̂₂), integrated together."""

    def slope(t, x):
        q, v, x1, x2 = x.reshape(4, 2)
        rate = x2 + gain * (q - x1)
        return np.concatenate([v, forward(q, v, tau(t)), rate, forward(q, rate, tau(t) + spring * (q - x1))])

    return slope


def settled(t, error, threshold):
    return t[np.flatnonzero(error > threshold)[-1] + 1]
