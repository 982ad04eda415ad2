//! RECT, the Robot Extensible Communication Toolkit.
