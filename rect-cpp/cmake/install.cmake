# Installs the library, its headers and its CMake and pkg-config files, and adds the target `uninstall`.
set(package_dir ${CMAKE_INSTALL_LIBDIR}/cmake/rect)
configure_package_config_file(${CMAKE_CURRENT_LIST_DIR}/rectConfig.cmake.in ${CMAKE_CURRENT_BINARY_DIR}/rectConfig.cmake
  INSTALL_DESTINATION ${package_dir} PATH_VARS CMAKE_INSTALL_INCLUDEDIR CMAKE_INSTALL_LIBDIR)
# Before version 1.0, minor versions are not compatible with each other.
write_basic_package_version_file(${CMAKE_CURRENT_BINARY_DIR}/rectConfigVersion.cmake COMPATIBILITY SameMinorVersion)
file(RELATIVE_PATH RECT_PREFIX_FROM_PC "/${CMAKE_INSTALL_LIBDIR}/pkgconfig" "/")
configure_file(${CMAKE_CURRENT_LIST_DIR}/rect.pc.in ${CMAKE_CURRENT_BINARY_DIR}/rect.pc @ONLY)

install(FILES include/rect.h include/rect.hpp DESTINATION ${CMAKE_INSTALL_INCLUDEDIR})
install(DIRECTORY include/rect DESTINATION ${CMAKE_INSTALL_INCLUDEDIR})
install(PROGRAMS ${lib_dir}/${shared_name} DESTINATION ${CMAKE_INSTALL_LIBDIR})
install(FILES ${lib_dir}/librect.so.${PROJECT_VERSION_MAJOR} ${lib_dir}/librect.so ${lib_dir}/librect.a
  DESTINATION ${CMAKE_INSTALL_LIBDIR})
install(FILES ${CMAKE_CURRENT_BINARY_DIR}/rectConfig.cmake ${CMAKE_CURRENT_BINARY_DIR}/rectConfigVersion.cmake
  ${CMAKE_CURRENT_LIST_DIR}/rectTargets.cmake DESTINATION ${package_dir})
install(FILES ${CMAKE_CURRENT_BINARY_DIR}/rect.pc DESTINATION ${CMAKE_INSTALL_LIBDIR}/pkgconfig)

add_custom_target(uninstall
  COMMAND ${CMAKE_COMMAND} -DMANIFEST=${CMAKE_CURRENT_BINARY_DIR}/install_manifest.txt
          -P ${CMAKE_CURRENT_LIST_DIR}/uninstall.cmake)
