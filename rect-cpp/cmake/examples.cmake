# Builds the examples as build/<preset>/examples/<name>.
foreach(name hello telemetry teleoperation camera transfer request wombat)
  add_executable(example_${name} ${repository}/examples/${name}/main.cpp)
  target_link_libraries(example_${name} PRIVATE rect::rect Threads::Threads)
  set_target_properties(example_${name} PROPERTIES OUTPUT_NAME ${name} RUNTIME_OUTPUT_DIRECTORY ${CMAKE_CURRENT_BINARY_DIR}/examples)
endforeach()

add_executable(example_hello_c ${repository}/examples/hello/main.c)
target_link_libraries(example_hello_c PRIVATE rect::rect)
set_target_properties(example_hello_c PROPERTIES OUTPUT_NAME hello_c RUNTIME_OUTPUT_DIRECTORY ${CMAKE_CURRENT_BINARY_DIR}/examples)
