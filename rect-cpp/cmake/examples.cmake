# Builds the examples as build/<preset>/examples/<name>.
foreach(name telemetry teleoperation camera transfer request wombat)
  add_executable(example_${name} ${repository}/examples/${name}/main.cpp)
  target_link_libraries(example_${name} PRIVATE rect::rect Threads::Threads)
  set_target_properties(example_${name} PROPERTIES OUTPUT_NAME ${name} RUNTIME_OUTPUT_DIRECTORY ${CMAKE_CURRENT_BINARY_DIR}/examples)
endforeach()
