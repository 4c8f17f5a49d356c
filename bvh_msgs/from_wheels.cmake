# Wheels of ROS lie in one prefix, as packages of apt do. Their targets name the folder of Python's
# headers on the machine that built them: take those of this Python.
find_package(Python3 REQUIRED COMPONENTS Interpreter Development.Module NumPy)
execute_process(
  COMMAND "${Python3_EXECUTABLE}" -c "import pathlib, rosidl_cmake; print(pathlib.Path(rosidl_cmake.__file__).parents[4])"
  OUTPUT_VARIABLE prefix OUTPUT_STRIP_TRAILING_WHITESPACE COMMAND_ERROR_IS_FATAL ANY)
list(PREPEND CMAKE_PREFIX_PATH "${prefix}")
set(ENV{AMENT_PREFIX_PATH} "${prefix}")

file(GLOB exports "${prefix}/share/*/cmake/*Export.cmake")
foreach(path IN LISTS exports)
  file(READ "${path}" text)
  string(REGEX REPLACE "/opt/python/[^;\"]*/numpy/_core/include" "${Python3_NumPy_INCLUDE_DIRS}" new "${text}")
  string(REGEX REPLACE "/opt/python/[^;\"]*/include/python[0-9.]+" "${Python3_INCLUDE_DIRS}" new "${new}")
  if(NOT new STREQUAL text)
    file(WRITE "${path}" "${new}")
  endif()
endforeach()
