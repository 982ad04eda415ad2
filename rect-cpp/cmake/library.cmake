# Builds or finds the library, and arranges it in the build folder like in an installation.
set(repository ${CMAKE_CURRENT_SOURCE_DIR}/..)
set(lib_dir ${CMAKE_CURRENT_BINARY_DIR}/lib)
set(shared_name librect.so.${PROJECT_VERSION})

if(RECT_LIBRARY_DIR)
  set(built_dir ${RECT_LIBRARY_DIR})
  foreach(file librect_cpp.so librect_cpp.a)
    if(NOT EXISTS ${built_dir}/${file})
      message(FATAL_ERROR "RECT_LIBRARY_DIR: ${built_dir} does not contain ${file}. "
                          "`cargo build --release -p rect-cpp` builds it in target/release.")
    endif()
  endforeach()
else()
  find_program(CARGO cargo HINTS $ENV{HOME}/.cargo/bin)
  if(NOT CARGO)
    message(FATAL_ERROR "cargo was not found. Install Rust from https://rustup.rs, or set RECT_LIBRARY_DIR to the folder of a built library.")
  endif()
  set(cargo_dir $ENV{CARGO_TARGET_DIR})
  if(NOT cargo_dir)
    set(cargo_dir ${repository}/target)
  endif()
  set(built_dir ${cargo_dir}/${RECT_CARGO_PROFILE})
  # Runs cargo in every build, because only cargo knows whether the library is up to date.
  add_custom_target(rect_cargo ALL
    COMMAND ${CARGO} build --locked --profile ${RECT_CARGO_PROFILE} -p rect-cpp --target-dir ${cargo_dir}
    WORKING_DIRECTORY ${repository}
    BYPRODUCTS ${built_dir}/librect_cpp.so ${built_dir}/librect_cpp.a
    USES_TERMINAL)
endif()

add_custom_command(
  OUTPUT ${lib_dir}/${shared_name} ${lib_dir}/librect.a
  COMMAND ${CMAKE_COMMAND} -E make_directory ${lib_dir}
  COMMAND ${CMAKE_COMMAND} -E copy ${built_dir}/librect_cpp.so ${lib_dir}/${shared_name}
  COMMAND ${CMAKE_COMMAND} -E copy ${built_dir}/librect_cpp.a ${lib_dir}/librect.a
  COMMAND ${CMAKE_COMMAND} -E create_symlink ${shared_name} ${lib_dir}/librect.so.${PROJECT_VERSION_MAJOR}
  COMMAND ${CMAKE_COMMAND} -E create_symlink librect.so.${PROJECT_VERSION_MAJOR} ${lib_dir}/librect.so
  DEPENDS ${built_dir}/librect_cpp.so ${built_dir}/librect_cpp.a)
add_custom_target(rect_library ALL DEPENDS ${lib_dir}/${shared_name} ${lib_dir}/librect.a)
if(TARGET rect_cargo)
  add_dependencies(rect_library rect_cargo)
endif()

# Defines the same targets as an installed package.
set(RECT_INCLUDE_DIR ${CMAKE_CURRENT_SOURCE_DIR}/include)
set(RECT_LIB_DIR ${lib_dir})
set(RECT_SHARED_LIBRARY ${lib_dir}/${shared_name})
include(${CMAKE_CURRENT_LIST_DIR}/rectTargets.cmake)
add_dependencies(rect::rect rect_library)
add_dependencies(rect::rect_static rect_library)
