# Where the library comes from, and how it lies in the build folder: as it will where it is installed.
set(repository ${CMAKE_CURRENT_SOURCE_DIR}/..)
set(lib_dir ${CMAKE_CURRENT_BINARY_DIR}/lib)
set(shared_name librect.so.${PROJECT_VERSION})

if(RECT_LIBRARY_DIR)
  set(built_dir ${RECT_LIBRARY_DIR})
  foreach(file librect_cpp.so librect_cpp.a)
    if(NOT EXISTS ${built_dir}/${file})
      message(FATAL_ERROR "RECT_LIBRARY_DIR: there is no ${file} in ${built_dir}; "
                          "`cargo build --release -p rect-cpp` makes it, in target/release")
    endif()
  endforeach()
else()
  find_program(CARGO cargo HINTS $ENV{HOME}/.cargo/bin)
  if(NOT CARGO)
    message(FATAL_ERROR "cargo is missing: install Rust from https://rustup.rs, or give a built library by RECT_LIBRARY_DIR")
  endif()
  set(cargo_dir $ENV{CARGO_TARGET_DIR})
  if(NOT cargo_dir)
    set(cargo_dir ${repository}/target)
  endif()
  set(built_dir ${cargo_dir}/${RECT_CARGO_PROFILE})
  # Cargo knows better than CMake what is out of date.
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

# The same targets as in an installed package.
set(RECT_INCLUDE_DIR ${CMAKE_CURRENT_SOURCE_DIR}/include)
set(RECT_LIB_DIR ${lib_dir})
set(RECT_SHARED_LIBRARY ${lib_dir}/${shared_name})
include(${CMAKE_CURRENT_LIST_DIR}/rectTargets.cmake)
add_dependencies(rect::rect rect_library)
add_dependencies(rect::rect_static rect_library)
