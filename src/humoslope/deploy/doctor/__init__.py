"""What is wrong, told from a recorded walk: of the program that ran the policy, of the motors, or of the sensors.

Three independent questions. Does the network give the recorded actions for the observations that the contract makes of
the recorded measurements (`network`)? Do torques, targets and encoders fit together by the contract's gains (`motors`)?
Does the IMU agree with the legs that carry it (`imu`)?
"""
