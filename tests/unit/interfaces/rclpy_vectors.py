"""Messages as rclpy of ROS 2 Kilted serializes them, without code of uros.

``VECTORS`` holds (type name, values, payload in hex): the values are keyword arguments, a dict for
a nested message; without any, the fields have their defaults. The payload is little-endian CDR
without the encapsulation header. Padding, in which rclpy leaves stale octets, is set to zero; there
may be padding after the last value. Runs on MicroPython.
"""

VECTORS = [
    (
        "std_msgs/msg/String",
        {"data": "c ßab"},
        "070000006320c39f616200",
    ),
    (
        "std_msgs/msg/Bool",
        {"data": False},
        "00000000",
    ),
    (
        "std_msgs/msg/Char",
        {"data": 255},
        "ff000000",
    ),
    (
        "std_msgs/msg/Byte",
        {"data": 29},
        "1d000000",
    ),
    (
        "std_msgs/msg/Empty",
        {},
        "00000000",
    ),
    (
        "std_msgs/msg/Int32",
        {"data": -2147483648},
        "00000080",
    ),
    (
        "std_msgs/msg/UInt64",
        {"data": 0},
        "0000000000000000",
    ),
    (
        "std_msgs/msg/Float32MultiArray",
        {"layout": {"dim": [], "data_offset": 0}, "data": []},
        "000000000000000000000000",
    ),
    (
        "std_msgs/msg/ColorRGBA",
        {"r": -1753.8125, "g": -12329.8125, "b": 9612.84375, "a": -13134.125},
        "003adbc440a740c66033164680384dc6",
    ),
    (
        "test_msgs/msg/BasicTypes",
        {
            "bool_value": False,
            "byte_value": 23,
            "char_value": 255,
            "float32_value": 11084.6875,
            "float64_value": 0.1,
            "int8_value": 29,
            "uint8_value": 0,
            "int16_value": 32767,
            "uint16_value": 12770,
            "int32_value": 911008802,
            "uint32_value": 884585951,
            "int64_value": 9223372036854775807,
            "uint64_value": 14653714999476281975,
        },
        (
            "0017ff00c0322d469a9999999999b93f1d00ff7fe231000022e44c36dfb5b934ffffffffffffff7f77e2"
            "983f27745ccb"
        ),
    ),
    (
        "test_msgs/msg/Strings",
        {
            "string_value": "bäY",
            "string_value_default1": "0_Z漢0Yäb",
            "string_value_default2": "9",
            "string_value_default3": "c😀Zc_0",
            "string_value_default4": "aßb😀9ä",
            "string_value_default5": "Z漢Zä0",
            "bounded_string_value": "😀0b/",
            "bounded_string_value_default1": "",
            "bounded_string_value_default2": "0漢",
            "bounded_string_value_default3": "ba漢漢Y",
            "bounded_string_value_default4": "äß/0Y",
            "bounded_string_value_default5": " _ßZa",
        },
        (
            "0500000062c3a459000000000c000000305f5ae6bca23059c3a4620002000000390000000a00000063f0"
            "9f98805a635f300000000c00000061c39f62f09f988039c3a400090000005ae6bca25ac3a43000000000"
            "08000000f09f988030622f0001000000000000000500000030e6bca2000000000a0000006261e6bca2e6"
            "bca25900000008000000c3a4c39f2f30590007000000205fc39f5a6100"
        ),
    ),
    (
        "test_msgs/msg/WStrings",
        {
            "wstring_value": "Zcäb0aX",
            "wstring_value_default1": "c漢X ",
            "wstring_value_default2": "_/0bc0",
            "wstring_value_default3": "9Y_c/ ",
            "array_of_wstrings": ["Y漢 Zß_ X", "bc", "Xß"],
            "bounded_sequence_of_wstrings": [""],
            "unbounded_sequence_of_wstrings": ["cYYac 9Zä", "Zc漢/9äßß漢", ""],
        },
        (
            "070000005a00000063000000e4000000620000003000000061000000580000000400000063000000226f"
            "00005800000020000000060000005f0000002f0000003000000062000000630000003000000006000000"
            "39000000590000005f000000630000002f000000200000000800000059000000226f0000200000005a00"
            "0000df0000005f00000020000000580000000200000062000000630000000200000058000000df000000"
            "010000000000000003000000090000006300000059000000590000006100000063000000200000003900"
            "00005a000000e4000000090000005a00000063000000226f00002f00000039000000e4000000df000000"
            "df000000226f000000000000000000000000000000000000000000000000000000000000000000000000"
            "0000000000000000000000000000"
        ),
    ),
    (
        "test_msgs/msg/Builtins",
        {
            "duration_value": {"sec": 2147483647, "nanosec": 0},
            "time_value": {"sec": -2147483648, "nanosec": 0},
        },
        "ffffff7f000000000000008000000000",
    ),
    (
        "test_msgs/msg/Nested",
        {
            "basic_types_value": {
                "bool_value": True,
                "byte_value": 26,
                "char_value": 0,
                "float32_value": -6470.703125,
                "float64_value": -1e300,
                "int8_value": -128,
                "uint8_value": 106,
                "int16_value": -32768,
                "uint16_value": 65535,
                "int32_value": 2147483647,
                "uint32_value": 4294967295,
                "int64_value": 9223372036854775807,
                "uint64_value": 0,
            },
        },
        (
            "011a0000a035cac59c7500883ce437fe806a0080ffff0000ffffff7fffffffffffffffffffffff7f0000"
            "000000000000"
        ),
    ),
    (
        "test_msgs/msg/UnboundedSequences",
        {
            "bool_values": [],
            "byte_values": b"\x87\xf5",
            "char_values": b"\x00",
            "float32_values": [-6776.265625, -14611.75],
            "float64_values": [0.1, -1e300],
            "int8_values": [127, -14],
            "uint8_values": b"r\x00",
            "int16_values": [-32768, 32767, -32768],
            "uint16_values": [65535, 25381],
            "int32_values": [2147483647, -2147483648],
            "uint32_values": [4294967295],
            "int64_values": [-9223372036854775808],
            "uint64_values": [0, 18446744073709551615, 17465322115368246502],
            "string_values": ["ca"],
            "basic_types_values": [
                {
                    "bool_value": False,
                    "byte_value": 238,
                    "char_value": 74,
                    "float32_value": 14703.453125,
                    "float64_value": -1e300,
                    "int8_value": -49,
                    "uint8_value": 0,
                    "int16_value": -30902,
                    "uint16_value": 13470,
                    "int32_value": -2147483648,
                    "uint32_value": 4294967295,
                    "int64_value": -9223372036854775808,
                    "uint64_value": 18446744073709551615,
                },
            ],
            "constants_values": [{}, {}, {}],
            "defaults_values": [
                {
                    "bool_value": False,
                    "byte_value": 9,
                    "char_value": 0,
                    "float32_value": -16126.28125,
                    "float64_value": 0.1,
                    "int8_value": -128,
                    "uint8_value": 242,
                    "int16_value": -16996,
                    "uint16_value": 65535,
                    "int32_value": 1187515947,
                    "uint32_value": 0,
                    "int64_value": 142298047962273169,
                    "uint64_value": 18446744073709551615,
                },
            ],
            "bool_values_default": [False],
            "byte_values_default": b"\xf4~\x84",
            "char_values_default": b"\x00",
            "float32_values_default": [-8413.390625, 9329.984375, 12590.640625],
            "float64_values_default": [0.1, 0.1],
            "int8_values_default": [-128, -128],
            "uint8_values_default": b"\xffp",
            "int16_values_default": [],
            "uint16_values_default": [0, 0, 56560],
            "int32_values_default": [-2147483648, -2147483648, -2147483648],
            "uint32_values_default": [4294967295, 4294967295],
            "int64_values_default": [2286051046221843340, -9223372036854775808],
            "uint64_values_default": [],
            "string_values_default": [],
            "alignment_check": -2147483648,
        },
        (
            "000000000200000087f5000001000000000000000200000020c2d3c5004f64c602000000000000009a99"
            "99999999b93f9c7500883ce437fe020000007ff200000200000072000000030000000080ff7f00800000"
            "02000000ffff256302000000ffffff7f0000008001000000ffffffff0100000000000000000000000000"
            "008003000000000000000000000000000000ffffffffffffffffe65c4cbeed4961f20100000003000000"
            "636100000100000000ee4a00d0bd65469c7500883ce437fecf004a879e34000000000080ffffffff0000"
            "000000000080ffffffffffffffff0300000000000000010000000009000020f97bc6000000009a999999"
            "9999b93f80f29cbdffff00002b0ec8460000000091d50519528bf901ffffffffffffffff010000000000"
            "000003000000f47e8400010000000000000003000000907503c6f0c7114690ba44460200000000000000"
            "9a9999999999b93f9a9999999999b93f020000008080000002000000ff70000000000000030000000000"
            "0000f0dc00000300000000000080000000800000008002000000ffffffffffffffff020000008c8b7684"
            "50afb91f000000000000008000000000000000000000008000000000"
        ),
    ),
    (
        "test_msgs/msg/BoundedPlainSequences",
        {
            "bool_values": [True],
            "byte_values": b"\xd8",
            "char_values": b"\x00\xfd",
            "float32_values": [-10521.015625, 1904.625],
            "float64_values": [],
            "int8_values": [-128],
            "uint8_values": b"\x08\xff",
            "int16_values": [],
            "uint16_values": [65535],
            "int32_values": [],
            "uint32_values": [49591106, 3931727770, 555016296],
            "int64_values": [-9223372036854775808],
            "uint64_values": [5348833356563087200],
            "basic_types_values": [
                {
                    "bool_value": True,
                    "byte_value": 9,
                    "char_value": 0,
                    "float32_value": -15378.28125,
                    "float64_value": -9.63132206602687,
                    "int8_value": -31,
                    "uint8_value": 0,
                    "int16_value": -32768,
                    "uint16_value": 56646,
                    "int32_value": 28715957,
                    "uint32_value": 0,
                    "int64_value": 9223372036854775807,
                    "uint64_value": 0,
                },
            ],
            "constants_values": [],
            "defaults_values": [
                {
                    "bool_value": True,
                    "byte_value": 28,
                    "char_value": 43,
                    "float32_value": 8577.453125,
                    "float64_value": 7.410756424954965,
                    "int8_value": 16,
                    "uint8_value": 124,
                    "int16_value": -32768,
                    "uint16_value": 0,
                    "int32_value": 2147483647,
                    "uint32_value": 4294967295,
                    "int64_value": -9223372036854775808,
                    "uint64_value": 0,
                },
                {
                    "bool_value": True,
                    "byte_value": 195,
                    "char_value": 255,
                    "float32_value": 1895.875,
                    "float64_value": 0.1,
                    "int8_value": -1,
                    "uint8_value": 0,
                    "int16_value": -32768,
                    "uint16_value": 65535,
                    "int32_value": 2147483647,
                    "uint32_value": 4294967295,
                    "int64_value": -4928793484230259811,
                    "uint64_value": 18446744073709551615,
                },
            ],
            "bool_values_default": [True, False, False],
            "byte_values_default": b"",
            "char_values_default": b"G\x08\x00",
            "float32_values_default": [],
            "float64_values_default": [],
            "int8_values_default": [-128],
            "uint8_values_default": b"\xe7\x19\t",
            "int16_values_default": [32767],
            "uint16_values_default": [],
            "int32_values_default": [1278601268, 111626851, 2147483647],
            "uint32_values_default": [],
            "int64_values_default": [9223372036854775807, 9223372036854775807],
            "uint64_values_default": [0, 18446744073709551615],
            "alignment_check": 828442609,
        },
        (
            "010000000100000001000000d80000000200000000fd000002000000106424c60014ee44000000000100"
            "0000800000000200000008ff00000000000001000000ffff0000000000000300000042b3f4029a6759ea"
            "68e0142101000000000000000000000000000080010000000000000060ffb33499df3a4a010000000109"
            "0000204970c60000000039a855a53c4323c0e100008046dd0000b52bb60100000000ffffffffffffff7f"
            "00000000000000000000000002000000011c2b00d0050646bc360f559da41d40107c008000000000ffff"
            "ff7fffffffff0000000000000080000000000000000001c3ff0000fcec449a9999999999b93fff000080"
            "ffff0000ffffff7fffffffff9d0b32a1706899bbffffffffffffffff0300000001000000000000000300"
            "0000470800000000000000000000010000008000000003000000e719090001000000ff7f000000000000"
            "0300000034e8354c634aa706ffffff7f0000000002000000ffffffffffffff7fffffffffffffff7f0200"
            "0000000000000000000000000000fffffffffffffffff10761310000000000000000"
        ),
    ),
    (
        "test_msgs/srv/Empty_Request",
        {},
        "00000000",
    ),
    (
        "test_msgs/srv/BasicTypes_Response",
        {
            "bool_value": False,
            "byte_value": 6,
            "char_value": 0,
            "float32_value": 15453.25,
            "float64_value": -4.6245446842150395,
            "int8_value": -78,
            "uint8_value": 111,
            "int16_value": 32767,
            "uint16_value": 65535,
            "int32_value": -2147483648,
            "uint32_value": 4294967295,
            "int64_value": 9223372036854775807,
            "uint64_value": 18446744073709551615,
            "string_value": "X__Xbä",
        },
        (
            "0006000000757146816046a4887f12c0b26fff7fffff000000000080ffffffffffffffffffffff7fffff"
            "ffffffffffff08000000585f5f5862c3a400"
        ),
    ),
    (
        "test_msgs/action/Fibonacci_Goal",
        {"order": -1759634804},
        "8c1a1e97",
    ),
    (
        "test_msgs/action/Fibonacci_SendGoal_Request",
        {
            "goal_id": {"uuid": b"\xffC\x00\x00\xff\x00\x00\xfb\xff\x9a\xff\xff\x00\x00\xff\x00"},
            "goal": {"order": 2147483647},
        },
        "ff430000ff0000fbff9affff0000ff00ffffff7f",
    ),
    (
        "test_msgs/action/Fibonacci_SendGoal_Response",
        {"accepted": True, "stamp": {"sec": -459993662, "nanosec": 4294967295}},
        "01000000c20d95e4ffffffff",
    ),
    (
        "test_msgs/action/Fibonacci_GetResult_Request",
        {"goal_id": {"uuid": b"\x00\x00\x1a\x92\x00\xff\x00\xff\x0e\xcch\x00\xffF\xff\x19"}},
        "00001a9200ff00ff0ecc6800ff46ff19",
    ),
    (
        "test_msgs/action/Fibonacci_GetResult_Response",
        {"status": -128, "result": {"sequence": [2147483647, -868563204, 2147483647]}},
        "8000000003000000ffffff7ffcc63accffffff7f",
    ),
    (
        "test_msgs/action/Fibonacci_FeedbackMessage",
        {
            "goal_id": {"uuid": b"\xff\xf7\x00U\x00j\xfe\xff\xff\x00\x00\x00\xaf\xff\xff\x84"},
            "feedback": {"sequence": [1663232365]},
        },
        "fff70055006afeffff000000afffff84010000006de92263",
    ),
    (
        "test_msgs/action/NestedMessage_FeedbackMessage",
        {
            "goal_id": {
                "uuid": b"\xff\xd3\xff\xff\xff\x8e\x00\x00\x00\xff\xff\x00\x00\xd9\xf2\x00"
            },
            "feedback": {
                "nested_field_no_pkg": {
                    "duration_value": {"sec": -1833358847, "nanosec": 4294967295},
                    "time_value": {"sec": -2147483648, "nanosec": 0},
                },
                "nested_field": {
                    "bool_value": False,
                    "byte_value": 20,
                    "char_value": 0,
                    "float32_value": -1141.859375,
                    "float64_value": 0.1,
                    "int8_value": -128,
                    "uint8_value": 128,
                    "int16_value": 24566,
                    "uint16_value": 0,
                    "int32_value": -1845324497,
                    "uint32_value": 4294967295,
                    "int64_value": 9223372036854775807,
                    "uint64_value": 18446744073709551615,
                },
                "nested_different_pkg": {"sec": 112861917, "nanosec": 4294967295},
            },
        },
        (
            "ffd3ffffff8e000000ffff0000d9f200012ab992ffffffff00000080000000000014000080bb8ec49a99"
            "99999999b93f8080f65f000000002f950292ffffffffffffffffffffff7fffffffffffffffffdd22ba06"
            "ffffffff"
        ),
    ),
    (
        "geometry_msgs/msg/Twist",
        {
            "linear": {"x": -1e300, "y": 0.1, "z": -0.033795105688493976},
            "angular": {"x": 0.1, "y": -4.854877557182238, "z": -1e300},
        },
        (
            "9c7500883ce437fe9a9999999999b93f00d66493974da1bf9a9999999999b93f74bab805656b13c09c75"
            "00883ce437fe"
        ),
    ),
    (
        "geometry_msgs/msg/TransformStamped",
        {
            "header": {"stamp": {"sec": -2147483648, "nanosec": 2988536121}, "frame_id": "Zß Xa😀"},
            "child_frame_id": "漢/9b",
            "transform": {
                "translation": {"x": 0.1, "y": 0.1, "z": 0.1},
                "rotation": {"x": -1e300, "y": -7.819838680039812, "z": 0.1, "w": -1e300},
            },
        },
        (
            "00000080397121b20b0000005ac39f205861f09f9880000007000000e6bca22f39620000000000009a99"
            "99999999b93f9a9999999999b93f9a9999999999b93f9c7500883ce437fe34117bca83471fc09a999999"
            "9999b93f9c7500883ce437fe"
        ),
    ),
    (
        "geometry_msgs/msg/PoseArray",
        {
            "header": {"stamp": {"sec": 709933423, "nanosec": 0}, "frame_id": ""},
            "poses": [
                {
                    "position": {"x": -1.6923013252257508, "y": -1e300, "z": -1.0071607085812992},
                    "orientation": {
                        "x": 7.671672748655073,
                        "y": 0.1,
                        "z": -1e300,
                        "w": -6.186329545749398,
                    },
                },
            ],
        },
        (
            "6fb9502a00000000010000000000000001000000000000002827ed8daa13fbbf9c7500883ce437fe10c4"
            "128c541df0bf145a24fbcaaf1e409a9999999999b93f9c7500883ce437febc16252ccdbe18c0"
        ),
    ),
    (
        "sensor_msgs/msg/Imu",
        {
            "header": {"stamp": {"sec": -2147483648, "nanosec": 4294967295}, "frame_id": "0cbab"},
            "orientation": {"x": -1e300, "y": 0.1, "z": 0.1, "w": -1e300},
            "orientation_covariance": [
                -1e300,
                -8.244794748834174,
                -1e300,
                -1e300,
                -1e300,
                -1e300,
                -1e300,
                -5.039739040758533,
                0.1,
            ],
            "angular_velocity": {"x": -1e300, "y": 0.1, "z": -4.859680951395415},
            "angular_velocity_covariance": [
                -8.742965176917348,
                -1e300,
                -3.300581729756356,
                -9.128288736615708,
                -1e300,
                -1e300,
                -9.924567681316725,
                8.32919207299625,
                0.1,
            ],
            "linear_acceleration": {"x": 0.1, "y": -7.8547725863473055, "z": -1e300},
            "linear_acceleration_covariance": [
                -1e300,
                0.1,
                0.1,
                -9.825896352146817,
                -3.933704372829907,
                5.456187598603252,
                -1e300,
                -0.7843760606857497,
                0.1,
            ],
        },
        (
            "00000080ffffffff060000003063626162000000000000009c7500883ce437fe9a9999999999b93f9a99"
            "99999999b93f9c7500883ce437fe9c7500883ce437fe5cf3c0bc557d20c09c7500883ce437fe9c750088"
            "3ce437fe9c7500883ce437fe9c7500883ce437fe9c7500883ce437feb0bae159b12814c09a9999999999"
            "b93f9c7500883ce437fe9a9999999999b93f2cf30c34507013c08eda81ee657c21c09c7500883ce437fe"
            "18a1d86497670ac0546bb00faf4122c09c7500883ce437fe9c7500883ce437fe456364ef60d923c0203e"
            "07dd8ba820409a9999999999b93f9a9999999999b93f1c843f81496b1fc09c7500883ce437fe9c750088"
            "3ce437fe9a9999999999b93f9a9999999999b93f6ab6fce2dba623c03e7e8bff39780fc0f25d83d722d3"
            "15409c7500883ce437feb0230dd39b19e9bf9a9999999999b93f"
        ),
    ),
    (
        "sensor_msgs/msg/Temperature",
        {
            "header": {"stamp": {"sec": 2147483647, "nanosec": 145443556}, "frame_id": "Zc _bbYä"},
            "temperature": 0.1,
            "variance": -1.5787944944984833,
        },
        "ffffff7fe44aab080a0000005a63205f626259c3a40000009a9999999999b93f089d0f04be42f9bf",
    ),
    (
        "sensor_msgs/msg/CompressedImage",
        {
            "header": {
                "stamp": {"sec": -2147483648, "nanosec": 4294967295},
                "frame_id": "ä_ßX漢9/",
            },
            "format": "😀",
            "data": b"\xff\xff",
        },
        "00000080ffffffff0c000000c3a45fc39f58e6bca2392f0005000000f09f98800000000002000000ffff",
    ),
    (
        "sensor_msgs/msg/JointState",
        {
            "header": {"stamp": {"sec": 2147483647, "nanosec": 0}, "frame_id": "cY_"},
            "name": ["b YX9"],
            "position": [0.1],
            "velocity": [0.1, 0.1, -1e300],
            "effort": [],
        },
        (
            "ffffff7f000000000400000063595f000100000006000000622059583900000001000000000000009a99"
            "99999999b93f03000000000000009a9999999999b93f9a9999999999b93f9c7500883ce437fe00000000"
            "00000000"
        ),
    ),
    (
        "sensor_msgs/msg/LaserScan",
        {
            "header": {"stamp": {"sec": -2147483648, "nanosec": 0}, "frame_id": "/äX_bZ9/c"},
            "angle_min": 13049.125,
            "angle_max": 651.953125,
            "angle_increment": -15968.546875,
            "time_increment": -9451.609375,
            "scan_time": 6533.90625,
            "range_min": -2120.390625,
            "range_max": -13929.390625,
            "ranges": [5899.3125, -7119.21875],
            "intensities": [],
        },
        (
            "00000080000000000b0000002fc3a4585f625a392f63000080e44b4600fd2244308279c670ae13c6402f"
            "cc45408604c590a559c602000000805ab845c079dec500000000"
        ),
    ),
    (
        "sensor_msgs/msg/CameraInfo",
        {
            "header": {"stamp": {"sec": -1052637754, "nanosec": 0}, "frame_id": " ßZcä"},
            "height": 0,
            "width": 4294967295,
            "distortion_model": "😀",
            "d": [0.1, 0.1, -1e300],
            "k": [
                -1e300,
                9.764774781957446,
                0.1,
                -3.7527622661981646,
                -1e300,
                -1e300,
                -1e300,
                0.1,
                -1e300,
            ],
            "r": [
                -1e300,
                0.1,
                -1e300,
                0.1,
                0.1,
                1.0309571240092517,
                -1e300,
                -8.219377760162278,
                8.544551189369503,
            ],
            "p": [
                0.1,
                0.1,
                0.1,
                -1e300,
                0.1,
                0.1,
                -1e300,
                -3.709480605516651,
                -1e300,
                -8.274111463990684,
                0.1,
                0.1,
            ],
            "binning_x": 2667402706,
            "binning_y": 4294967295,
            "roi": {
                "x_offset": 4294967295,
                "y_offset": 4294967295,
                "height": 0,
                "width": 827192198,
                "do_rectify": False,
            },
        },
        (
            "c60542c1000000000800000020c39f5a63c3a40000000000ffffffff05000000f09f9880000000000300"
            "0000000000009a9999999999b93f9a9999999999b93f9c7500883ce437fe9c7500883ce437fe22a06a8f"
            "908723409a9999999999b93f28df1739a8050ec09c7500883ce437fe9c7500883ce437fe9c7500883ce4"
            "37fe9a9999999999b93f9c7500883ce437fe9c7500883ce437fe9a9999999999b93f9c7500883ce437fe"
            "9a9999999999b93f9a9999999999b93fd02ab3e5cc7ef03f9c7500883ce437fec2bb2248527020c00aae"
            "da69cf1621409a9999999999b93f9a9999999999b93f9a9999999999b93f9c7500883ce437fe9a999999"
            "9999b93f9a9999999999b93f9c7500883ce437feecb8ee2a04ad0dc09c7500883ce437feeb987a56588c"
            "20c09a9999999999b93f9a9999999999b93fd255fd9effffffffffffffffffffffff0000000086f34d31"
            "00"
        ),
    ),
    (
        "sensor_msgs/msg/BatteryState",
        {
            "header": {"stamp": {"sec": 739822926, "nanosec": 0}, "frame_id": "ä09/ß😀"},
            "voltage": 3684.046875,
            "temperature": 11145.828125,
            "current": 3814.953125,
            "charge": -48.578125,
            "capacity": 11517.28125,
            "design_capacity": 9123.390625,
            "percentage": 7697.203125,
            "power_supply_status": 228,
            "power_supply_health": 0,
            "power_supply_technology": 0,
            "present": False,
            "cell_voltage": [14108.125, -966.609375, 12898.71875],
            "cell_temperature": [-4615.765625, 14628.859375, 9852.828125],
            "location": "b",
            "serial_number": "Z ",
        },
        (
            "4ecd182c000000000c000000c3a430392fc39ff09f988000c040664550272e46406f6e45005042c220f5"
            "3346908d0e46a089f045e40000000300000080705c4600a771c4e08a494603000000203e90c570936446"
            "50f319460200000062000000030000005a2000"
        ),
    ),
    (
        "sensor_msgs/msg/PointCloud2",
        {
            "header": {"stamp": {"sec": 2147483647, "nanosec": 0}, "frame_id": "b_"},
            "height": 3150273587,
            "width": 0,
            "fields": [
                {"name": "a/", "offset": 0, "datatype": 255, "count": 0},
                {"name": "ä😀YcZ", "offset": 0, "datatype": 130, "count": 2062046340},
                {"name": "ä9XZ", "offset": 0, "datatype": 255, "count": 4021823525},
            ],
            "is_bigendian": True,
            "point_step": 4294967295,
            "row_step": 2279430361,
            "data": b"\xe7\xff",
            "is_dense": False,
        },
        (
            "ffffff7f0000000003000000625f0000335cc5bb000000000300000003000000612f000000000000ff00"
            "0000000000000a000000c3a4f09f988059635a00000000000000820000008454e87a06000000c3a43958"
            "5a00000000000000ff0000002528b8ef01000000ffffffffd958dd8702000000e7ff00"
        ),
    ),
    (
        "nav_msgs/msg/Odometry",
        {
            "header": {"stamp": {"sec": 2147483647, "nanosec": 4294967295}, "frame_id": "0"},
            "child_frame_id": "cä漢",
            "pose": {
                "pose": {
                    "position": {"x": -1e300, "y": -1e300, "z": -3.7985511661711584},
                    "orientation": {
                        "x": -1e300,
                        "y": 4.660775512723767,
                        "z": 0.1,
                        "w": -4.1805676197928126,
                    },
                },
                "covariance": [
                    -1.3553425047268046,
                    0.1,
                    0.1,
                    0.1,
                    0.1,
                    -1e300,
                    -1e300,
                    -1e300,
                    1.6718183906607287,
                    -1e300,
                    -1e300,
                    0.1,
                    0.1,
                    -1e300,
                    -8.083906611253525,
                    -7.106167395221354,
                    -1e300,
                    0.1,
                    -8.877388738848664,
                    7.853531144608958,
                    -1e300,
                    2.0376293267543772,
                    0.1,
                    0.1,
                    -9.119960358511134,
                    0.1,
                    0.1,
                    0.1,
                    -9.75299811174876,
                    0.1,
                    0.1,
                    0.36516183735176355,
                    0.1389643024797298,
                    -1.695109633597614,
                    -1e300,
                    -8.724656209309972,
                ],
            },
            "twist": {
                "twist": {
                    "linear": {"x": -9.03018444865028, "y": 5.659483593393155, "z": -1e300},
                    "angular": {"x": 6.888649528719107, "y": 0.1, "z": -1e300},
                },
                "covariance": [
                    0.1,
                    -4.771465177491803,
                    -1e300,
                    7.825478576072165,
                    -1e300,
                    -1e300,
                    2.7173187663834923,
                    -1.2789455524483788,
                    -1e300,
                    0.1,
                    -8.291577714674892,
                    -1e300,
                    8.094050472395015,
                    0.1,
                    -1e300,
                    -1e300,
                    0.1,
                    -2.4110213059830095,
                    8.43355800104781,
                    6.830413487406581,
                    -0.6101410877495255,
                    0.1,
                    -1.2557198173259891,
                    -1e300,
                    -1e300,
                    0.1,
                    0.1,
                    0.1,
                    -7.7621391256632855,
                    -1e300,
                    9.548161497986552,
                    0.1,
                    -7.231956170108138,
                    2.6775625411639083,
                    0.1,
                    -8.684694639370147,
                ],
            },
        },
        (
            "ffffff7fffffffff02000000300000000700000063c3a4e6bca20000000000009c7500883ce437fe9c75"
            "00883ce437fe301a37cb6e630ec09c7500883ce437feb8950456a2a412409a9999999999b93f22e8d6b7"
            "e6b810c0b8e24a9f7baff5bf9a9999999999b93f9a9999999999b93f9a9999999999b93f9a9999999999"
            "b93f9c7500883ce437fe9c7500883ce437fe9c7500883ce437feb0d30ba4c4bffa3f9c7500883ce437fe"
            "9c7500883ce437fe9a9999999999b93f9a9999999999b93f9c7500883ce437fe1081aecef52a20c04782"
            "4925b76c1cc09c7500883ce437fe9a9999999999b93fa777c61839c121c008da8011046a1f409c750088"
            "3ce437fe903ebe9a104d00409a9999999999b93f9a9999999999b93f573eb1716b3d22c09a9999999999"
            "b93f9a9999999999b93f9a9999999999b93f44d2eff7888123c09a9999999999b93f9a9999999999b93f"
            "00144bc1cf5ed73f401f3b0f95c9c13f10fb76472b1ffbbf9c7500883ce437fec9a87f23067321c0fb99"
            "0756740f22c0187dc7aa4fa316409c7500883ce437fe48d15d24fa8d1b409a9999999999b93f9c750088"
            "3ce437fe9a9999999999b93f0d52adf7fa1513c09c7500883ce437fe481d7f414a4d1f409c7500883ce4"
            "37fe9c7500883ce437feb064139f11bd05404816929c8f76f4bf9c7500883ce437fe9a9999999999b93f"
            "cb8a99ac499520c09c7500883ce437fe4a382e62273020409a9999999999b93f9c7500883ce437fe9c75"
            "00883ce437fe9a9999999999b93ff83fd989c54903c0c6d67650fbdd20403846cae957521b4000903a9a"
            "4686e3bf9a9999999999b93fe0aac5a96d17f4bf9c7500883ce437fe9c7500883ce437fe9a9999999999"
            "b93f9a9999999999b93f9a9999999999b93f44e7ee326e0c1fc09c7500883ce437fea68eb59fa8182340"
            "9a9999999999b93f24e112eb85ed1cc06059dae8a56b05409a9999999999b93fbeaeb74b905e21c0"
        ),
    ),
    (
        "nav_msgs/msg/Path",
        {
            "header": {"stamp": {"sec": -2147483648, "nanosec": 0}, "frame_id": "XXb"},
            "poses": [],
        },
        "0000008000000000040000005858620000000000",
    ),
    (
        "rcl_interfaces/msg/Log",
        {
            "stamp": {"sec": 576267609, "nanosec": 4294967295},
            "level": 0,
            "name": "😀",
            "msg": "YZZ",
            "file": "YaZY_Y",
            "function": "",
            "line": 4294967295,
        },
        (
            "59255922ffffffff0000000005000000f09f98800000000004000000595a5a000700000059615a595f59"
            "00000100000000000000ffffffff"
        ),
    ),
    (
        "rcl_interfaces/msg/ParameterEvent",
        {
            "stamp": {"sec": 2147483647, "nanosec": 4294967295},
            "node": "",
            "new_parameters": [
                {
                    "name": "ä",
                    "value": {
                        "type": 0,
                        "bool_value": True,
                        "integer_value": -9223372036854775808,
                        "double_value": -1e300,
                        "string_value": "0",
                        "byte_array_value": b"\xfd",
                        "bool_array_value": [False, False],
                        "integer_array_value": [5815169068967297876],
                        "double_array_value": [0.1],
                        "string_array_value": [],
                    },
                },
            ],
            "changed_parameters": [
                {
                    "name": "😀bßZZb _",
                    "value": {
                        "type": 202,
                        "bool_value": True,
                        "integer_value": 9223372036854775807,
                        "double_value": -1e300,
                        "string_value": "_99c _",
                        "byte_array_value": b"\xeb",
                        "bool_array_value": [False],
                        "integer_array_value": [],
                        "double_array_value": [1.6316216180712289, -1e300],
                        "string_array_value": ["00", "äXcZ"],
                    },
                },
                {
                    "name": "ß_漢X9XY",
                    "value": {
                        "type": 154,
                        "bool_value": False,
                        "integer_value": 8757911605430103562,
                        "double_value": -3.4687485392548005,
                        "string_value": "cXZXY",
                        "byte_array_value": b"",
                        "bool_array_value": [False],
                        "integer_array_value": [],
                        "double_array_value": [0.1],
                        "string_array_value": [" YXb", "Y"],
                    },
                },
                {
                    "name": "_ 0",
                    "value": {
                        "type": 0,
                        "bool_value": True,
                        "integer_value": -9223372036854775808,
                        "double_value": -7.163749447880157,
                        "string_value": "a漢X_/ ",
                        "byte_array_value": b"uu\\",
                        "bool_array_value": [],
                        "integer_array_value": [
                            -3449277788199438880,
                            9223372036854775807,
                            -826516031125777005,
                        ],
                        "double_array_value": [0.36504532027915104, 0.1, -1e300],
                        "string_array_value": [],
                    },
                },
            ],
            "deleted_parameters": [
                {
                    "name": "_baY9Xc",
                    "value": {
                        "type": 102,
                        "bool_value": True,
                        "integer_value": 1375398366046810612,
                        "double_value": -1e300,
                        "string_value": "aß😀/Z9Z ",
                        "byte_array_value": b"k^\xc8",
                        "bool_array_value": [],
                        "integer_array_value": [9223372036854775807, -9223372036854775808],
                        "double_array_value": [],
                        "string_array_value": ["ß漢ßZäY", "X", "漢 9X"],
                    },
                },
                {
                    "name": "0Xcc_😀",
                    "value": {
                        "type": 35,
                        "bool_value": True,
                        "integer_value": 9223372036854775807,
                        "double_value": 9.922774626961694,
                        "string_value": "😀/",
                        "byte_array_value": b"\xb5u\x88",
                        "bool_array_value": [False, False, False],
                        "integer_array_value": [
                            -9223372036854775808,
                            9223372036854775807,
                            9223372036854775807,
                        ],
                        "double_array_value": [-8.858742552208911, 0.1, -1e300],
                        "string_array_value": [],
                    },
                },
                {
                    "name": "",
                    "value": {
                        "type": 0,
                        "bool_value": False,
                        "integer_value": 1995948668770958747,
                        "double_value": 0.1,
                        "string_value": "😀0",
                        "byte_array_value": b"Nj",
                        "bool_array_value": [False, True, False],
                        "integer_array_value": [],
                        "double_array_value": [-6.052589789858224, 0.1],
                        "string_array_value": ["9", "Y", "X/c009"],
                    },
                },
            ],
        },
        (
            "ffffff7fffffffff01000000000000000100000003000000c3a400000100000000000000000000809c75"
            "00883ce437fe020000003000000001000000fd000000020000000000000001000000000000005483a248"
            "75a1b35001000000000000009a9999999999b93f00000000030000000d000000f09f988062c39f5a5a62"
            "205f00ca010000000000ffffffffffffff7f9c7500883ce437fe070000005f393963205f000001000000"
            "eb0000000100000000000000000000000200000000000000200011451f1bfa3f9c7500883ce437fe0200"
            "0000030000003030000006000000c3a458635a0000000b000000c39f5fe6bca258395859009a00000000"
            "000000000aaeee27345a8a79582df13bffbf0bc00600000063585a585900000000000000010000000000"
            "000000000000010000009a9999999999b93f020000000500000020595862000000000200000059000000"
            "040000005f2030000001000000000000000000000000008088886defada71cc00900000061e6bca2585f"
            "2f20000000000300000075755c000000000003000000e035ba6e20b421d0ffffffffffffff7f9315957b"
            "0ca087f4030000000000000000090a0ce75cd73f9a9999999999b93f9c7500883ce437fe000000000300"
            "0000080000005f6261593958630066010000f471dfd8866516139c7500883ce437fe0d00000061c39ff0"
            "9f98802f5a395a2000000000030000006b5ec800000000000200000000000000ffffffffffffff7f0000"
            "00000000008000000000030000000c000000c39fe6bca2c39f5ac3a45900020000005800000007000000"
            "e6bca220395800000a000000305863635ff09f988000230100000000ffffffffffffff7f16c278ea75d8"
            "234006000000f09f98802f00000003000000b57588000300000000000000030000000000000000000080"
            "ffffffffffffff7fffffffffffffff7f030000000000000079d7921aadb721c09a9999999999b93f9c75"
            "00883ce437fe000000000100000000000000000000009bbd0140bd08b31b9a9999999999b93f06000000"
            "f09f988030000000020000004e6a00000300000000010000000000000200000000000000a82d0e19da35"
            "18c09a9999999999b93f030000000200000039000000020000005900000007000000582f633030390000"
            "00000000000000"
        ),
    ),
    (
        "rcl_interfaces/srv/SetParameters_Request",
        {"parameters": []},
        "00000000",
    ),
    (
        "rcl_interfaces/srv/DescribeParameters_Response",
        {
            "descriptors": [
                {
                    "name": "_c漢0X0c",
                    "type": 0,
                    "description": "0漢ä0ß",
                    "additional_constraints": "/0Z ",
                    "read_only": True,
                    "dynamic_typing": False,
                    "floating_point_range": [],
                    "integer_range": [],
                },
                {
                    "name": "ßßaaä",
                    "type": 23,
                    "description": "😀b900",
                    "additional_constraints": "aX",
                    "read_only": False,
                    "dynamic_typing": False,
                    "floating_point_range": [
                        {
                            "from_value": -8.110693713770807,
                            "to_value": -1e300,
                            "step": 5.5704798587467685,
                        },
                    ],
                    "integer_range": [],
                },
                {
                    "name": " Z Y",
                    "type": 255,
                    "description": "Z/0 ",
                    "additional_constraints": "9Y/9Z",
                    "read_only": False,
                    "dynamic_typing": False,
                    "floating_point_range": [],
                    "integer_range": [
                        {
                            "from_value": -9223372036854775808,
                            "to_value": 9223372036854775807,
                            "step": 0,
                        },
                    ],
                },
            ],
        },
        (
            "030000000a0000005f63e6bca2305830630000000a00000030e6bca2c3a430c39f000000050000002f30"
            "5a2000010000000000000000000009000000c39fc39f6161c3a40017000009000000f09f988062393030"
            "00000000030000006158000000000000010000006c09b1d8ac3820c09c7500883ce437fe546041df2b48"
            "16400000000005000000205a205900ff0000050000005a2f3020000000000600000039592f395a000000"
            "00000000010000000000000000000080ffffffffffffff7f0000000000000000"
        ),
    ),
    (
        "lifecycle_msgs/msg/TransitionEvent",
        {
            "timestamp": 16997406585815567608,
            "transition": {"id": 30, "label": "ä äcßß漢漢"},
            "start_state": {"id": 0, "label": ""},
            "goal_state": {"id": 234, "label": "bß"},
        },
        (
            "f80c6cd23bebe2eb1e00000011000000c3a420c3a463c39fc39fe6bca2e6bca2000000000100000000ea"
            "00000400000062c39f00"
        ),
    ),
    (
        "lifecycle_msgs/srv/GetAvailableTransitions_Response",
        {
            "available_transitions": [
                {
                    "transition": {"id": 255, "label": "_"},
                    "start_state": {"id": 255, "label": "😀Y"},
                    "goal_state": {"id": 255, "label": " a"},
                },
            ],
        },
        "01000000ff000000020000005f00ff0006000000f09f98805900ff0003000000206100",
    ),
    (
        "action_msgs/msg/GoalStatusArray",
        {
            "status_list": [
                {
                    "goal_info": {
                        "goal_id": {
                            "uuid": (
                                b"\xff\xff\x00\xd7\xff\x00\xc6\xff\xd3\x00\x00M\xff\x00\x00\x00"
                            ),
                        },
                        "stamp": {"sec": -2147483648, "nanosec": 4294967295},
                    },
                    "status": -128,
                },
                {
                    "goal_info": {
                        "goal_id": {
                            "uuid": (b"\xbbJ\xff\xff\x00\x00\x00\xff\xff\xff\xff\xbc\xff\x00\xffS"),
                        },
                        "stamp": {"sec": 2147483647, "nanosec": 4294967295},
                    },
                    "status": 127,
                },
            ],
        },
        (
            "02000000ffff00d7ff00c6ffd300004dff00000000000080ffffffff80bb4affff000000ffffffffbcff"
            "00ff53000000ffffff7fffffffff7f"
        ),
    ),
    (
        "action_msgs/srv/CancelGoal_Response",
        {
            "return_code": -128,
            "goals_canceling": [
                {
                    "goal_id": {
                        "uuid": b"\x00\x9e\x00\xff\xc0\xff\x91\xff\xff\x00\xffH\xff\xff+\xff"
                    },
                    "stamp": {"sec": -1142322889, "nanosec": 1698642047},
                },
                {
                    "goal_id": {
                        "uuid": (b"\xff\xff\xeb,\x00\xff\x84\xff\x00\x00\x00\xff\xff\x00\xff\x00"),
                    },
                    "stamp": {"sec": 2147483647, "nanosec": 4294967295},
                },
            ],
        },
        (
            "8000000002000000009e00ffc0ff91ffff00ff48ffff2bff3789e9bb7f383f65ffffeb2c00ff84ff0000"
            "00ffff00ff00ffffff7fffffffff"
        ),
    ),
    (
        "std_srvs/srv/SetBool_Response",
        {"success": True, "message": "abaX//ä0ä"},
        "010000000c000000616261582f2fc3a430c3a400",
    ),
    (
        "test_msgs/msg/Arrays",
        {},
        (
            "000000000000000000000000000000000000000000000000000000000000000000000000000000000000"
            "000000000000000000000000000000000000000000000000000000000000000000000000000000000000"
            "000000000000000000000000000000000000000000000000000000000000000000000000000000000000"
            "000000000000000000000000000000000000010000000000000001000000000000000100000000000000"
            "000000000000000000000000000000000000000000000000000000000000000000000000000000000000"
            "000000000000000000000000000000000000000000000000000000000000000000000000000000000000"
            "000000000000000000000000000000000000000000000000000000000000000000000000000000000000"
            "00000000000000000000000000000000000000000001326400000000903f00000000000000000000f23f"
            "cec818fcd0070000d08affff60ea000000a69dfdffffffff80f0fa0200000000013264000000903f0000"
            "00000000f23fcec818fcd0070000d08affff60ea000000a69dfdffffffff80f0fa020000000001326400"
            "0000903f000000000000f23fcec818fcd0070000d08affff60ea000000a69dfdffffffff80f0fa020000"
            "00000001000001ff00017f0000000000903f00000000000090bf6f1283c0ca2109400000000000000000"
            "6f1283c0ca2109c0007f800001ff0000ff7f008000000100ffff000000000000ffffff7f000000800000"
            "000001000000ffffffff000000000000000000000000ffffffffffffff7f000000000000008000000000"
            "000000000100000000000000ffffffffffffffff01000000000000000a0000006d61782076616c756500"
            "00000a0000006d696e2076616c756500000000000000"
        ),
    ),
    (
        "test_msgs/msg/Defaults",
        {},
        (
            "013264000000903f000000000000f23fcec818fcd0070000d08affff60ea000000a69dfdffffffff80f0"
            "fa0200000000"
        ),
    ),
    (
        "test_msgs/msg/Constants",
        {},
        "00000000",
    ),
    (
        "test_msgs/msg/Strings",
        {},
        (
            "01000000000000000d00000048656c6c6f20776f726c6421000000000d00000048656c6c6f27776f726c"
            "6421000000000d00000048656c6c6f22776f726c6421000000000d00000048656c6c6f27776f726c6421"
            "000000000d00000048656c6c6f22776f726c64210000000001000000000000000d00000048656c6c6f20"
            "776f726c6421000000000d00000048656c6c6f27776f726c6421000000000d00000048656c6c6f22776f"
            "726c6421000000000d00000048656c6c6f27776f726c6421000000000d00000048656c6c6f22776f726c"
            "642100"
        ),
    ),
    (
        "test_msgs/msg/WStrings",
        {},
        (
            "000000000c00000048000000650000006c0000006c0000006f00000020000000770000006f0000007200"
            "00006c00000064000000210000000c00000048000000650000006c0000006c000000f600000020000000"
            "77000000f6000000720000006c000000640000002100000007000000cf300000ed300000fc300000ef30"
            "0000fc300000eb300000c930000000000000000000000000000000000000000000000000000000000000"
            "0000000000000000000000000000000000000000"
        ),
    ),
    (
        "test_msgs/msg/BoundedSequences",
        {},
        (
            "000000000000000000000000000000000000000000000000000000000000000000000000000000000000"
            "00000000000000000000000000000000000000000000000000000300000000010000030000000001ff00"
            "0300000000017f00030000000000903f00000000000090bf030000006f1283c0ca210940000000000000"
            "00006f1283c0ca2109c003000000007f8000030000000001ff00030000000000ff7f0080000003000000"
            "00000100ffff00000300000000000000ffffff7f00000080030000000000000001000000ffffffff0300"
            "0000000000000000000000000000ffffffffffffff7f0000000000000080030000000000000000000000"
            "000000000100000000000000ffffffffffffffff0300000001000000000000000a0000006d6178207661"
            "6c75650000000a0000006d696e2076616c75650000000000000000000000000000000000000000000000"
        ),
    ),
    (
        "geometry_msgs/msg/Quaternion",
        {},
        "000000000000000000000000000000000000000000000000000000000000f03f",
    ),
    (
        "sensor_msgs/msg/NavSatFix",
        {},
        (
            "00000000000000000100000000fe00000000000000000000000000000000000000000000000000000000"
            "000000000000000000000000000000000000000000000000000000000000000000000000000000000000"
            "0000000000000000000000000000000000000000000000000000000000"
        ),
    ),
    (
        "rcl_interfaces/msg/ParameterDescriptor",
        {},
        "0100000000000000010000000000000001000000000000000000000000000000",
    ),
    (
        "rcl_interfaces/msg/Log",
        {},
        (
            "000000000000000000000000010000000000000001000000000000000100000000000000010000000000"
            "000000000000"
        ),
    ),
]
