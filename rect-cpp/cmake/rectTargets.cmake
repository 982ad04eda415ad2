# Defines rect::rect, the shared library, and rect::rect_static, both with the headers. RECT_INCLUDE_DIR, RECT_LIB_DIR and
# RECT_SHARED_LIBRARY contain their locations.
add_library(rect::rect SHARED IMPORTED GLOBAL)
set_target_properties(rect::rect PROPERTIES
  IMPORTED_LOCATION ${RECT_SHARED_LIBRARY}
  IMPORTED_SONAME librect.so.0
  INTERFACE_INCLUDE_DIRECTORIES ${RECT_INCLUDE_DIR})

# The static library needs the system libraries of the Rust standard library and of the Bluetooth link.
add_library(rect::rect_static STATIC IMPORTED GLOBAL)
set_target_properties(rect::rect_static PROPERTIES
  IMPORTED_LOCATION ${RECT_LIB_DIR}/librect.a
  INTERFACE_INCLUDE_DIRECTORIES ${RECT_INCLUDE_DIR}
  INTERFACE_LINK_LIBRARIES "pthread;dl;m;gcc_s;stdc++")
