//! Definitions of common messages, for bags that lack them: rosbag2 wrote none into SQLite before ROS 2 Iron.

/// The definition of a type, given as `package/Type`.
pub(crate) fn definition(message: &str) -> Option<&'static str> {
    Some(match message {
        "builtin_interfaces/Time" | "builtin_interfaces/Duration" => "int32 sec\nuint32 nanosec",
        "std_msgs/Header" => "builtin_interfaces/Time stamp\nstring frame_id",
        "std_msgs/Float32" => "float32 data",
        "std_msgs/Float64" => "float64 data",
        "std_msgs/Float32MultiArray" => "MultiArrayLayout layout\nfloat32[] data",
        "std_msgs/Float64MultiArray" => "MultiArrayLayout layout\nfloat64[] data",
        "std_msgs/MultiArrayLayout" => "MultiArrayDimension[] dim\nuint32 data_offset",
        "std_msgs/MultiArrayDimension" => "string label\nuint32 size\nuint32 stride",
        "geometry_msgs/Vector3" | "geometry_msgs/Point" => "float64 x\nfloat64 y\nfloat64 z",
        "geometry_msgs/Quaternion" => "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
        "geometry_msgs/Pose" => "Point position\nQuaternion orientation",
        "geometry_msgs/Twist" | "geometry_msgs/Accel" => "Vector3 linear\nVector3 angular",
        "geometry_msgs/Wrench" => "Vector3 force\nVector3 torque",
        "geometry_msgs/Vector3Stamped" => "std_msgs/Header header\nVector3 vector",
        "geometry_msgs/PoseStamped" => "std_msgs/Header header\nPose pose",
        "geometry_msgs/TwistStamped" => "std_msgs/Header header\nTwist twist",
        "geometry_msgs/AccelStamped" => "std_msgs/Header header\nAccel accel",
        "geometry_msgs/WrenchStamped" => "std_msgs/Header header\nWrench wrench",
        "sensor_msgs/JointState" => {
            "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort"
        }
        "sensor_msgs/Imu" => {
            "std_msgs/Header header
             geometry_msgs/Quaternion orientation
             float64[9] orientation_covariance
             geometry_msgs/Vector3 angular_velocity
             float64[9] angular_velocity_covariance
             geometry_msgs/Vector3 linear_acceleration
             float64[9] linear_acceleration_covariance"
        }
        "trajectory_msgs/JointTrajectoryPoint" => {
            "float64[] positions
             float64[] velocities
             float64[] accelerations
             float64[] effort
             builtin_interfaces/Duration time_from_start"
        }
        "control_msgs/InterfaceValue" => "string[] interface_names\nfloat64[] values",
        "control_msgs/DynamicJointState" => {
            "std_msgs/Header header\nstring[] joint_names\nInterfaceValue[] interface_values"
        }
        _ => return None,
    })
}
