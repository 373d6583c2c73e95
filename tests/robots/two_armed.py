"""A small two-armed robot in URDF, with everything a file can say: a lift, grippers, a head, fixed frames."""

from __future__ import annotations

HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<robot name="two_armed">
  <material name="grey"><color rgba="0.5 0.5 0.5 1"/></material>
  <link name="base"/>
  <joint name="lift" type="prismatic">
    <parent link="base"/> <child link="torso"/> <origin xyz="0 0 0.4"/>
    <axis xyz="0 0 1"/> <limit lower="0" upper="0.3" effort="500" velocity="0.1"/>
  </joint>
  <link name="torso">
    <inertial> <origin xyz="0.01 0 0.2" rpy="0 0 0.3"/> <mass value="20"/>
      <inertia ixx="0.5" ixy="0.01" ixz="0" iyy="0.6" iyz="0.02" izz="0.3"/> </inertial>
    <visual>
      <origin xyz="0 0 0.2"/>
      <geometry><box size="0.3 0.2 0.4"/></geometry>
      <material name="grey"/>
    </visual>
  </link>
  <joint name="neck" type="continuous">
    <parent link="torso"/> <child link="head"/> <origin xyz="0 0 0.5"/>
    <axis xyz="0 0 1"/> <limit effort="5" velocity="2"/>
  </joint>
  <link name="head">
    <inertial><mass value="2"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>
  </link>
"""

ARM = """
  <joint name="SIDE_shoulder" type="revolute">
    <parent link="torso"/> <child link="SIDE_upper"/> <origin xyz="0 SIGN0.2 0.4" rpy="SIGN1.5707963267948966 0 0"/>
    <axis xyz="0 0 2"/> <limit lower="-2" upper="2.5" effort="80" velocity="2"/>
    <dynamics damping="0.5" friction="0.1"/>
  </joint>
  <link name="SIDE_upper">
    <inertial> <origin xyz="0 0.02 0.15" rpy="0.1 0.2 0.3"/> <mass value="3"/>
      <inertia ixx="0.03" ixy="0.001" ixz="0.002" iyy="0.028" iyz="-0.001" izz="0.006"/> </inertial>
    <visual><geometry><cylinder radius="0.05" length="0.3"/></geometry></visual>
    <collision><geometry><cylinder radius="0.05" length="0.3"/></geometry></collision>
  </link>
  <joint name="SIDE_mount" type="fixed">
    <parent link="SIDE_upper"/> <child link="SIDE_box"/> <origin xyz="0.05 0 0.1" rpy="0 0.4 0"/>
  </joint>
  <link name="SIDE_box">
    <inertial><mass value="0.5"/><inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.0015"/></inertial>
  </link>
  <joint name="SIDE_elbow" type="revolute">
    <parent link="SIDE_upper"/> <child link="SIDE_lower"/> <origin xyz="0.02 0 0.3" rpy="0.2 -0.5 1.1"/>
    <axis xyz="0.6 0 0.8"/> <limit lower="0" upper="2.4" effort="60" velocity="0"/>
  </joint>
  <link name="SIDE_lower">
    <inertial> <origin xyz="0 0 0.1"/> <mass value="2"/>
      <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.003"/> </inertial>
  </link>
  <joint name="SIDE_slide" type="prismatic">
    <parent link="SIDE_lower"/> <child link="SIDE_hand"/> <origin xyz="0 0 0.2" rpy="0 0 -0.7"/>
    <axis xyz="0 0.1 1"/> <limit lower="0.05" upper="0.2" effort="100" velocity="0.5"/>
  </joint>
  <link name="SIDE_hand">
    <inertial> <origin xyz="0.01 0 0.03"/> <mass value="0.8"/>
      <inertia ixx="0.002" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.001"/> </inertial>
  </link>
  <joint name="SIDE_finger1" type="prismatic">
    <parent link="SIDE_hand"/> <child link="SIDE_finger1_link"/> <origin xyz="0 0 0.06"/>
    <axis xyz="0 1 0"/> <limit lower="0.01" upper="0.04" effort="20" velocity="0.2"/>
  </joint>
  <link name="SIDE_finger1_link">
    <inertial><mass value="0.1"/><inertia ixx="1e-5" ixy="0" ixz="0" iyy="1e-5" iyz="0" izz="1e-5"/></inertial>
  </link>
  <joint name="SIDE_finger2" type="prismatic">
    <parent link="SIDE_hand"/> <child link="SIDE_finger2_link"/> <origin xyz="0 0 0.06" rpy="0 0 3.141592653589793"/>
    <axis xyz="0 1 0"/> <limit lower="0" upper="0.04" effort="20" velocity="0.2"/>
    <mimic joint="SIDE_finger1" multiplier="1"/>
  </joint>
  <link name="SIDE_finger2_link">
    <inertial><mass value="0.1"/><inertia ixx="1e-5" ixy="0" ixz="0" iyy="1e-5" iyz="0" izz="1e-5"/></inertial>
    <visual><geometry><mesh filename="package://two_armed/finger.stl" scale="1 -1 1"/></geometry></visual>
  </link>
  <joint name="SIDE_tool" type="fixed">
    <parent link="SIDE_hand"/> <child link="SIDE_grasp"/> <origin xyz="0 0 0.1"/>
  </joint>
  <link name="SIDE_grasp"/>
"""

SIDES = {"left": "", "right": "-"}
TWO_ARMED = (
    HEAD + "".join(ARM.replace("SIDE", side).replace("SIGN", sign) for side, sign in SIDES.items()) + "</robot>\n"
)
