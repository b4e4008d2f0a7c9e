"""Files of other programs: tables, arrays, ROS bags, logs of CAN buses."""
